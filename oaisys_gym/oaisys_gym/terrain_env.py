"""What all environments have in common: worlds, images, seeds and pictures."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.geometry import MAX_M
from oaisys_core.types import DEPTH, FloatArray, ModuleMetadata, Pose
from oaisys_gym.simulator import EpisodeSimulator

RGB = "rgb"

MAX_WORLD_SEED = 2**31 - 1

Observation = dict[str, NDArray[Any]]
Action = NDArray[np.float32]


class TerrainEnv(gymnasium.Env[Any, Action], ABC):
    """An environment in worlds of a simulator, seen by the first camera of its rig.

    An observation has the images of ``modalities`` by name: ``depth`` (H, W) float32, planar
    metres, clipped to ``max_range_m``, 0 where a sensor with faults measured nothing; ``rgb``
    (H, W, 3) uint8; ``semantic_0`` (H, W) uint16; ``instance`` (H, W) uint32. What else it has,
    each environment says.

    The seed of `reset` decides on the world, the start and everything else that is drawn.
    ``options={"world_seed": 7}`` asks for one world. Episodes in the same world build it once,
    unless `reset` is given a seed.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as gymnasium declares it
        "render_modes": ["rgb_array"],
        "render_fps": 4,
    }

    def __init__(
        self,
        *,
        config: str | Path | Mapping[str, Any] | None = None,
        address: str = "",
        modalities: Sequence[str] = (DEPTH,),
        world_seeds: Sequence[int] = (),
        max_range_m: float = 20.0,
        render_mode: str | None = None,
    ) -> None:
        """Start a simulator, or connect to one.

        Args:
            config: YAML file of the worlds, or its content; None: small mounds without Blender.
            address: Of a simulator that serves and that nobody else uses; empty: start one, which
                ends with this environment.
            modalities: Images in the observations.
            world_seeds: Seeds of the worlds among which each episode draws one; none: any world.
            max_range_m: Depth beyond which nothing is seen.
            render_mode: ``rgb_array``, or None.

        Raises:
            InvalidInputError: The camera has no such modality, or another argument is wrong.
            OaisysError: The simulator cannot be used.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InvalidInputError("render_mode", render_mode, "None or 'rgb_array'")
        self.render_mode = render_mode
        self.max_range_m = _checked_range_m(max_range_m)
        seeds = _list_of("world_seeds", world_seeds, "whole numbers")
        self._world_seeds = [_checked_seed("world_seeds", seed) for seed in seeds]
        self._modalities = _names("modalities", modalities)
        self._simulator = EpisodeSimulator(config, address)
        try:
            self._sensor = self._simulator.client.info().sensors[0]
            self.image_spaces = {name: self._image_space(name) for name in self._modalities}
        except BaseException:
            self._simulator.close()
            raise
        self._batch_id = -1
        self._world_seed = -1
        self._pose: Pose | None = None
        self._images: Observation = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; see `gymnasium.Env.reset`.

        Raises:
            InvalidInputError: There is no such option.
        """
        super().reset(seed=seed)
        if options is not None and not isinstance(options, Mapping):
            raise InvalidInputError("options", options, "a dictionary with world_seed")
        unknown = sorted(set(options or {}) - {"world_seed"})
        if unknown:
            raise InvalidInputError("options", unknown[0], "world_seed")
        wanted = (options or {}).get("world_seed")
        # Drawn in any case: an option must not change what else an episode draws.
        drawn = self._draw_world_seed()
        world_seed = drawn if wanted is None else _checked_seed("world_seed", wanted)
        # What samples draw counts on within a world.
        self._enter_world(world_seed, anew=seed is not None)
        self._begin()
        return self._observe(), self._info()

    def render(self) -> NDArray[np.uint8] | None:
        """Return the (H, W, 3) picture from where the camera is; None without a render mode.

        Raises:
            InvalidInputError: The camera has no colour.
        """
        if self.render_mode is None or self._pose is None:
            return None
        if RGB not in self._images:
            self._images |= self._request(self._pose, (RGB,))
        return self._images[RGB]

    def close(self) -> None:
        """End the simulator if this environment has started it."""
        self._simulator.close()

    @abstractmethod
    def _begin(self) -> None:
        """Draw the start of an episode in the current world, and look from there."""

    @abstractmethod
    def _observe(self) -> Observation:
        """Return the observation."""

    def _info(self) -> dict[str, Any]:
        return {"world_seed": self._world_seed}

    @property
    def pose(self) -> Pose:
        """Pose of the rig in ``map``."""
        self.require_reset()
        assert self._pose is not None
        return self._pose

    def require_reset(self) -> None:
        """Raise `gymnasium.error.ResetNeeded` where no episode has begun."""
        if self._pose is None:
            raise gymnasium.error.ResetNeeded("call reset before anything else")

    @property
    def extent_m(self) -> FloatArray:
        """(2, 2) lowest and highest x and y of the ground, in ``map``."""
        return self._extent_m

    def surface_heights_m(self, xy_m: FloatArray) -> FloatArray:
        """Return the (N,) heights of ground or rocks at (N, 2) points; NaN off the stage."""
        points_m = np.column_stack((xy_m, np.zeros(len(xy_m))))
        return self._simulator.client.query_height(points_m).surface_height_m

    def _look(self, pose: Pose, *, with_depth: bool) -> None:
        """Render from a pose of the rig; with depth even where observations have none."""
        wanted = (*self._modalities, DEPTH) if with_depth else self._modalities
        self._images = self._request(pose, tuple(dict.fromkeys(wanted)))
        self._pose = pose

    def _request(self, pose: Pose, modalities: tuple[str, ...]) -> Observation:
        for modality in modalities:
            if modality not in self._sensor.modalities:
                expected = one_of(self._sensor.modalities, modality)
                raise InvalidInputError("modalities", modality, expected)
        if not modalities:
            return {}
        sample = self._simulator.client.render_sample(
            pose, modalities=modalities, sensors=(self._sensor.name,)
        )
        return {name: np.array(sample.frame(self._sensor.name, name).data) for name in modalities}

    def _observed_images(self) -> Observation:
        """Return the images of an observation."""
        images = {name: self._images[name] for name in self._modalities}
        if DEPTH in images:
            measured_m = np.nan_to_num(images[DEPTH], nan=0.0, neginf=0.0)
            images[DEPTH] = np.clip(measured_m, 0, self.max_range_m)
        return images

    def _draw_world_seed(self) -> int:
        if self._world_seeds:
            return int(self.np_random.choice(self._world_seeds))
        return int(self.np_random.integers(MAX_WORLD_SEED))

    def _enter_world(self, seed: int, *, anew: bool) -> None:
        client = self._simulator.client
        stays = seed == self._world_seed and client.info().batch_id == self._batch_id
        if anew or not stays:
            # Faults of sensors are drawn from the number of the batch, which counts on.
            by_seed = ModuleMetadata(sensor={"faults": {"batch": seed}})
            self._batch_id = client.step_batch(seed=seed, reuse_stage=stays, metadata=by_seed)
            self._world_seed = seed
            self._extent_m = np.reshape(np.array(client.info().stage_extent_m), (2, 2))

    def _image_space(self, modality: str) -> spaces.Space[Any]:
        camera = self._sensor.intrinsics
        size = (camera.height_px, camera.width_px)
        if modality not in self._sensor.modalities:
            raise InvalidInputError(
                "modalities", modality, one_of(self._sensor.modalities, modality)
            )
        if modality == DEPTH:
            return spaces.Box(0.0, self.max_range_m, size, np.float32)
        if modality == RGB:
            return spaces.Box(0, 255, (*size, 3), np.uint8)
        if modality.startswith("semantic_"):
            return spaces.Box(0, 2**16 - 1, size, np.uint16)
        if modality == "instance":
            return spaces.Box(0, 2**32 - 1, size, np.uint32)
        expected = "depth, rgb, semantic_N or instance in an observation"
        raise InvalidInputError("modalities", modality, expected)


def _checked_range_m(value: object) -> float:
    is_number = isinstance(value, int | float | np.integer | np.floating)
    if not is_number or isinstance(value, bool) or not 0 < value <= MAX_M:  # type: ignore[operator]
        expected = f"a finite number above 0, of at most {MAX_M:g}"
        raise InvalidInputError("max_range_m", value, expected)
    return float(value)  # type: ignore[arg-type]


def _list_of(field: str, values: object, kind: str) -> list[Any]:
    """Return the values of a sequence, which is no text."""
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise InvalidInputError(field, values, f"a sequence of {kind}")
    return list(values)


def _names(field: str, values: object) -> tuple[str, ...]:
    """Return the names in a sequence, each once."""
    names = _list_of(field, values, "names")
    for name in names:
        if not isinstance(name, str):
            raise InvalidInputError(field, name, "a name")
    return tuple(dict.fromkeys(names))


def _checked_seed(field: str, seed: object) -> int:
    is_whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if not (is_whole and 0 <= int(seed) <= MAX_WORLD_SEED):  # type: ignore[call-overload]
        raise InvalidInputError(field, seed, f"a whole number from 0 to {MAX_WORLD_SEED}")
    return int(seed)  # type: ignore[call-overload, no-any-return]
