"""A world as a backend has built it: building, changing, undoing, and questions about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core.config import SimulationConfig, config_sha256
from oaisys_core.config.worlds import WorldSeeds, draw_world
from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_core.procedural.environment.low_sun import LowSunWarning
from oaisys_core.procedural.terrain.surroundings.far_ground import with_land
from oaisys_core.render import make_backend
from oaisys_core.render.base import Backend
from oaisys_core.render.view_renderer import FramesPlacement, ViewRenderer, leave_frames
from oaisys_core.scene import Scene
from oaisys_core.system.freed_memory import return_freed_memory
from oaisys_core.types import (
    Extent,
    FloatArray,
    HeightGrid,
    HeightQuery,
    ModuleMetadata,
    ObjectPage,
    ObjectQuery,
    ProgressCallback,
    SimulatorInfo,
    TriangleMesh,
    ignore_progress,
)
from oaisys_core.world.batch import Batch, BatchSeeds, Snapshot
from oaisys_core.world.height_grids import GridPlan, height_grid
from oaisys_core.world.module import World, require
from oaisys_core.world.module_set import DRAW_SHARE, ModuleSet
from oaisys_core.world.modules import SensorsModule, StageModule
from oaisys_core.world.reuse import assets_sha256


class BuiltWorld:
    """The current world of a simulation, and the modules and the backend that made it."""

    def __init__(
        self,
        config: SimulationConfig,
        backend: Backend | None = None,
        *,
        pose_cache_bytes: int = 0,
        place_frames: FramesPlacement = leave_frames,
    ) -> None:
        """Set all modules up; nothing is rendered yet.

        Args:
            config: What worlds are drawn from.
            backend: A backend to use instead of a new one as configured.
            pose_cache_bytes: Largest size of images that are kept for repeated views; 0 for none.
            place_frames: Moves frames that become ready together, for instance into shared memory;
                samples and the cache hold the moved ones. It is called by the thread that asks a
                group for its result.

        Raises:
            ConfigError: The configuration names something that does not exist.
            BackendUnavailableError: The backend cannot run here.
        """
        self._config = config
        self._config_sha256 = config_sha256(config)
        self._assets_sha256 = assets_sha256(config)
        self._modules = ModuleSet.of(config)
        self._backend = backend if backend is not None else make_backend(config.backend)
        self._views = ViewRenderer(self._backend, pose_cache_bytes, place_frames)
        self._low_sun = LowSunWarning()
        self._undo: Callable[[], None] | None = None
        self._batch: Batch | None = None
        self._last_batch_id = 0
        self._modules.setup()

    def info(self) -> SimulatorInfo:
        """Return what this simulator is and its current batch and sample."""
        batch = self._batch
        ground = batch.world.ground if batch else None
        render = batch.world.render if batch else None
        return SimulatorInfo(
            backend=self._backend.name,
            backend_version=self._backend.version,
            seed=self._config.seed,
            config_sha256=self._config_sha256,
            quality=render.quality if render else self._config.render.quality,
            sensors=self._sensors.sensors,
            lidars=self._sensors.lidars,
            imus=self._sensors.imus,
            semantic_labels=dict(batch.world.semantic_labels) if batch else {},
            batch_id=batch.id if batch else 0,
            sample_id=batch.sample_id if batch else 0,
            stage_extent_m=ground.extent_m if ground else None,
            device=self._backend.device,
            group_counts=batch.world.group_counts if batch else (),
            rig_pose=self._sensors.rig_pose if batch else None,
            odometry_drifts=self._sensors.odometry_drifts,
            georeference=batch.world.georeference if batch else None,
        )

    @property
    def world_config(self) -> SimulationConfig:
        """The configuration of the current world, in which all that worlds draw is drawn."""
        self._current()
        return self._modules.config

    @property
    def draws(self) -> Mapping[str, Any]:
        """What was drawn of the configuration for the current world, by path."""
        return self._current().drawn

    @property
    def batch_seed(self) -> int:
        """Seed of the current world."""
        return self._current().seeds.seed

    @property
    def scene(self) -> Scene:
        """The current world, as the backend was given it."""
        return self._current().world.scene()

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return the surface of the world as rendered, in ``map``."""
        self._current()
        return self._backend.ground_truth_mesh()

    def query_height(self, points_m: ArrayLike, *, on_stage: bool = False) -> HeightQuery:
        """Return the heights under (N, 3) points in ``map``; NaN where there is no ground.

        Args:
            points_m: The points.
            on_stage: Return NaN off the stage even where land surrounds it.

        Raises:
            InvalidInputError: The points have another shape or are not finite.
        """
        points = np.asarray(points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InvalidInputError("points_m", points.shape, "(N, 3) finite coordinates")
        world = self._current().world
        ground = with_land(world.surface, None if on_stage else world.scene().far_ground)
        ground_m = ground.height_at(points[:, :2])
        surface_m: FloatArray = np.full(len(points), np.nan)
        inside = np.isfinite(ground_m)
        if inside.any():
            surface_m[inside] = self._backend.surface_height_m(points[inside, :2])
        return HeightQuery(ground_m, surface_m, points[:, 2] - surface_m)

    def list_objects(
        self, query: ObjectQuery, metadata: ModuleMetadata | None = None
    ) -> ObjectPage:
        """Return objects of the world that are shown; nothing changes.

        Args:
            query: Which of them.
            metadata: Return them as they will be after a sample with this metadata.

        Raises:
            InvalidInputError: The query cannot be answered, or the metadata applied.
            NotReadyError: There is no world yet.
        """
        batch = self._current()
        metadata = metadata or ModuleMetadata()
        self._modules.check(metadata, is_batch=False)
        return self._modules.assets.list_objects(batch.world, metadata.asset, query)

    def height_grid(
        self,
        resolution_m: float,
        extent_m: Extent | None = None,
        progress: ProgressCallback = ignore_progress,
    ) -> HeightGrid:
        """Return the heights of ground and topmost surface on a grid; NaN off the stage.

        Args:
            resolution_m: Edge of a cell.
            extent_m: (min_x, min_y, max_x, max_y) in ``map``; None: the whole stage.
            progress: Called with the progress; may raise `CancelledError`.

        Raises:
            InvalidInputError: It would have no cells, or too many.
            NotReadyError: Before the first batch.
        """
        return height_grid(self.grid_plan(resolution_m, extent_m), self.stage_heights, progress)

    def grid_plan(self, resolution_m: float, extent_m: Extent | None = None) -> GridPlan:
        """Return where the cells of `height_grid` are.

        Raises:
            InvalidInputError: It would have no cells, or too many.
            NotReadyError: Before the first batch.
        """
        stage_m = require(self._current().world.ground).extent_m
        return GridPlan.of(resolution_m, extent_m or stage_m)

    def stage_heights(self, points_m: FloatArray) -> HeightQuery:
        """Return the heights under (N, 3) points in ``map``; NaN off the stage."""
        return self.query_height(points_m, on_stage=True)

    def state(self) -> dict[str, Any]:
        """Return all that another process needs to continue from here, as JSON-able data."""
        pose = self._sensors.rig_pose
        batch, state = self._batch, None
        if batch is not None and pose is not None:
            state = batch.to_state(pose)
        return {"last_batch_id": self._last_batch_id, "batch": state}

    def restore(
        self, state: Mapping[str, Any], progress: ProgressCallback = ignore_progress
    ) -> None:
        """Build the world of a `state` again and continue as that simulation would have."""
        self._batch = None
        batch_state = state["batch"]
        if batch_state is not None:
            wanted = Batch.from_state(batch_state)
            batch = self._build(wanted.id, wanted.seeds, wanted.metadata, progress)
            if wanted.sample_id:
                # What moves or changes by itself is where the last sample left it.
                batch.sample_id = wanted.sample_id - 1
                self._apply(batch, ModuleMetadata(sensor=wanted.metadata.sensor))
            batch.sample_id, batch.last_rig_poses = wanted.sample_id, wanted.last_rig_poses
        self._last_batch_id = int(state["last_batch_id"])

    def save(self, path: Path) -> None:
        """Write the current world as a file of the backend's own kind (``.blend``).

        Raises:
            NotReadyError: Before the first batch.
            InvalidInputError: The backend has no such files.
        """
        self._current()
        self._backend.save(path)

    def close(self) -> None:
        """Release the backend; the simulation cannot be used afterwards."""
        self._batch = None
        self._backend.close()

    @property
    def _stage(self) -> StageModule:
        return self._modules.stage

    @property
    def _sensors(self) -> SensorsModule:
        return self._modules.sensors

    def _current(self) -> Batch:
        if self._batch is None:
            raise NotReadyError("there is no world yet: step a batch first (StepBatch)")
        return self._batch

    def _build(
        self,
        batch_id: int,
        seeds: BatchSeeds,
        metadata: ModuleMetadata,
        progress: ProgressCallback,
    ) -> Batch:
        """Draw a world and let the backend build it; if building fails there is no world."""
        return_freed_memory()
        modules, drawn = self._modules, {}
        if self._config.draws or self._config.variants:
            world = draw_world(self._config, WorldSeeds(**vars(seeds)))
            modules, drawn = modules.for_world(world.config), dict(world.drawn)
        batch = modules.draw(batch_id, seeds, metadata, self._batch, progress)
        batch.drawn = drawn
        self._batch, self._undo, self._modules = None, None, modules
        self._views.forget_world()
        self._backend.build(
            batch.world.scene(),
            lambda p: progress(replace(p, fraction=DRAW_SHARE + (1 - DRAW_SHARE) * p.fraction)),
        )
        self._batch, self._last_batch_id = batch, batch_id
        self._low_sun.check(require(batch.world.sky), batch.world.scene().far_ground)
        return_freed_memory()
        return batch

    @contextmanager
    def _undone_on_failure(self, batch: Batch) -> Iterator[None]:
        """Undo the sample if the block raises."""
        self._undo = None
        world = batch.world
        undo = partial(self._roll_back, world, Snapshot(batch, world, *self._modules.all))
        world.semantic_labels = dict(world.semantic_labels)  # modules change it in place
        try:
            yield
        except BaseException:
            undo()
            raise
        self._undo = undo

    def _roll_back(self, world: World, before: Snapshot) -> None:
        changed = world.scene()
        before.restore()
        if changed.differs_from(world.scene()):
            self._backend.update(world.scene())

    def _with_admitted_pose(self, batch: Batch, metadata: ModuleMetadata) -> ModuleMetadata:
        """Return the metadata with the admitted pose and without the pose policy."""
        sensor = dict(metadata.sensor or {})
        policy = sensor.pop("pose_policy", None)
        if "pose" not in sensor and self._sensors.moves_itself:
            return metadata if policy is None else replace(metadata, sensor=sensor)
        pose = sensor.get("pose") or require(self._sensors.rig_pose)
        sensor["pose"] = self._sensors.admit(pose, batch.world, self.stage_heights, policy)
        return replace(metadata, sensor=sensor)

    def _apply(self, batch: Batch, metadata: ModuleMetadata) -> None:
        before = batch.world.scene()
        self._modules.step_sample(batch, metadata)
        after = batch.world.scene()
        self._low_sun.check(after.sky, after.far_ground)
        if after.differs_from(before):
            self._backend.update(after)
        if "pose" not in (metadata.sensor or {}) and self._sensors.moves_itself:
            self._sensors.move(batch.world, batch.seeds.seed, self.stage_heights)
        batch.world.refine()
        at_pose = batch.world.scene()
        if at_pose.differs_from(after):
            self._backend.update(at_pose)
