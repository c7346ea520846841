"""Images of everything but colour, by modality, and the base class of further modalities.

While Cycles renders colour, one core is idle; a thread computes these images there.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from oaisys_core import extensions
from oaisys_core.errors import ConfigError, RenderError, quote
from oaisys_core.geometry import invert, project, transform_points
from oaisys_core.raycast.surface import CORES as CORES
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.base import FrameGroup
from oaisys_core.scene import PlacedCamera, Placement, Primitive, Scene
from oaisys_core.scene.objects import ids_in_images
from oaisys_core.types import (
    DEPTH,
    DEPTH_TRUE,
    DISPARITY,
    FLOW,
    INSTANCE,
    NORMAL,
    RANGE,
    RANGE_TRUE,
    RENDERED,
    FloatArray,
    Frame,
    ModalitySpec,
    semantic_level,
)

T = TypeVar("T")


class GeometryPass(ABC):
    """Computes a modality of another package, named by its entry point. It must not keep state."""

    spec: ModalitySpec
    """Type and meaning of its pixels."""

    @abstractmethod
    def compute(self, surface: Surface, view: View, camera: PlacedCamera) -> NDArray[Any]:
        """Return the image, (H, W) or (H, W, channels), of the dtype in ``spec``."""


def compute_extension_pass(
    surface: Surface, view: View, camera: PlacedCamera, modality: str
) -> NDArray[Any]:
    """Return the image of an installed pass.

    Raises:
        ConfigError: There is no such pass, or it is not a `GeometryPass`.
        RenderError: Its image does not have the shape and dtype of its ``spec``.
    """
    kind = extensions.load(extensions.PASSES, modality)
    if not (isinstance(kind, type) and issubclass(kind, GeometryPass)):
        raise ConfigError(
            f"{extensions.PASSES}: {quote(modality)} is {quote(kind)}, expected a GeometryPass"
        )
    image = kind().compute(surface, view, camera)
    shape = view.depth_m.shape + ((kind.spec.channels,) if kind.spec.channels > 1 else ())
    if image.shape != shape or image.dtype != kind.spec.dtype:
        received = f"{image.dtype} {image.shape}"
        raise RenderError(f"{modality}: received {received}, expected {kind.spec.dtype} {shape}")
    return image


def geometry_frames(surface: Surface, camera: PlacedCamera, memory: PoseMemory) -> dict[str, Frame]:
    """Cast rays and return a camera's frames except colour and albedo, by modality."""
    if set(camera.modalities) <= RENDERED:
        return {}
    return frames_of(surface, surface.view(camera), camera, memory)


def frames_of(
    surface: Surface, view: View, camera: PlacedCamera, memory: PoseMemory
) -> dict[str, Frame]:
    """Return the frames of a view except colour and albedo, by modality."""
    return {
        modality: frame_of(camera, modality, _image(surface, view, camera, memory, modality))
        for modality in camera.modalities
        if modality not in RENDERED
    }


def frame_of(camera: PlacedCamera, modality: str, image: NDArray[Any]) -> Frame:
    """Return an image as a frame of a camera."""
    return Frame(camera.name, modality, image, camera.intrinsics, camera.T_map_camera)


def _image(
    surface: Surface, view: View, camera: PlacedCamera, memory: PoseMemory, modality: str
) -> NDArray[Any]:
    """Return the image of one modality, see `modality_spec`."""
    level = semantic_level(modality)
    if level is not None:
        return surface.semantic_ids(view, level)
    if modality in (DEPTH, DEPTH_TRUE):
        return view.depth_m.astype(np.float32)
    if modality in (RANGE, RANGE_TRUE):
        return np.asarray(view.depth_m * np.linalg.norm(view.directions, axis=-1), np.float32)
    if modality == INSTANCE:
        return ids_in_images(view.instance_ids)
    if modality == NORMAL:
        row_poses = camera.row_poses()
        poses = camera.T_map_camera if row_poses is None else row_poses
        return np.asarray(surface.normals(view) @ poses[..., :3, :3], np.float32)
    if modality == FLOW:
        return memory.flow(view, camera, surface.scene)
    if modality == DISPARITY:
        return disparity_px(view, camera)
    return compute_extension_pass(surface, view, camera, modality)


def disparity_px(view: View, camera: PlacedCamera) -> NDArray[np.float32]:
    """Return the (H, W) disparities of a camera of a stereo pair: fx times baseline over depth.

    A point at column u of the left image is at u minus its disparity in the right one. 0 where
    nothing was hit.
    """
    fx_baseline = camera.intrinsics.fx_px * camera.stereo_baseline_m
    return np.asarray(fx_baseline / view.depth_m, np.float32)


class BackgroundGeometry:
    """Frames that a thread computes beside the caller's work; a context manager.

    The end of the block waits for the thread.

    Attributes:
        group: The frames; its result raises whatever computing them raised.
    """

    def __init__(self, compute: Callable[[], tuple[Frame, ...]]) -> None:
        """Start the thread; ``compute`` runs in a copy of the caller's context."""
        self._busy_s: float | None = None
        self._executor = ThreadPoolExecutor(1, "geometry")
        future = self.then(compute)
        self.group = FrameGroup(future.result, future.done)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()

    def then(self, compute: Callable[[], T]) -> Future[T]:
        """Have the same thread compute something after the frames."""
        return self._executor.submit(copy_context().run, self._time, compute)

    def cost_s(self, seconds: float) -> float:
        """Return by how much it lengthened work that took all cores for ``seconds``."""
        # Threads share the cores alike.
        most_s = seconds / (CORES + 1)
        return most_s if self._busy_s is None else min(self._busy_s / CORES, most_s)

    def _time(self, compute: Callable[[], T]) -> T:
        computed = compute()
        self._busy_s = time.thread_time()
        return computed


@dataclass(frozen=True)
class ScenePoses:
    """The objects' poses at one sample."""

    placements: tuple[Placement, ...]
    primitives: tuple[Primitive, ...]


class PoseMemory:
    """The objects' poses at each camera's previous sample of the batch."""

    def __init__(self) -> None:
        self._previous: dict[str, ScenePoses] = {}
        self._before_previous: dict[str, ScenePoses] = {}

    def forget(self) -> None:
        """Forget all poses, for a new batch."""
        self._previous, self._before_previous = {}, {}

    def remember(self, cameras: Sequence[PlacedCamera], scene: Scene) -> None:
        """Keep the current poses as the previous ones of these cameras."""
        poses = ScenePoses(scene.placements, scene.primitives)
        self._before_previous = self._previous
        self._previous = {**self._previous, **{camera.name: poses for camera in cameras}}

    def withdraw(self) -> None:
        """Undo the last `remember`."""
        self._previous = self._before_previous

    def flow(self, view: View, camera: PlacedCamera, scene: Scene) -> NDArray[np.float32]:
        """Return the (H, W, 2) flow in pixels, see `modality_spec`; NaN where it is unknown.

        The sky moves by the camera's rotation only. The flow of an object is unknown at its first
        sample, and that of a moving one also after a restart.
        """
        if camera.T_map_previous is None:
            return np.full((*view.depth_m.shape, 2), np.nan, np.float32)
        earlier_m = np.where(view.is_hit[..., None], view.points_m, 0.0)
        self._move_back(earlier_m, view.instance_ids, self._previous.get(camera.name), scene)
        T_previous_map = invert(camera.T_map_previous)
        then = transform_points(T_previous_map, earlier_m)
        then[~view.is_hit] = view.directions[~view.is_hit] @ T_previous_map[:3, :3].T
        if not camera.intrinsics.is_fisheye:
            then[~(then[..., 2] > 0)] = np.nan
        height, width = view.depth_m.shape
        now = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        pixels = project(then.reshape(-1, 3), camera.intrinsics).reshape(height, width, 2)
        return np.asarray(now - pixels, np.float32)

    @staticmethod
    def _move_back(
        points_m: FloatArray,
        instance_ids: NDArray[np.uint32],
        before: ScenePoses | None,
        now: Scene,
    ) -> None:
        """Move points on moving objects back in place; NaN if the previous pose is unknown."""
        placements, primitives = _change(now, before)
        if not placements and not primitives:
            return
        visible = np.unique(instance_ids)
        poses_now = _poses(placements, primitives, visible)
        poses_before = _poses(before.placements, before.primitives, visible) if before else {}
        for instance_id, T_map_object in poses_now.items():
            pixels = instance_ids == instance_id
            if instance_id not in poses_before:
                points_m[pixels] = np.nan
                continue
            T = poses_before[instance_id] @ np.linalg.inv(T_map_object)
            points_m[pixels] = transform_points(T, points_m[pixels])


def _change(
    now: Scene, before: ScenePoses | None
) -> tuple[tuple[Placement, ...], tuple[Primitive, ...]]:
    """Return the objects that have changed; without previous poses, those that may move."""
    if before is None:
        return tuple(p for p in now.placements if p.is_moving), ()
    kept = {id(part) for part in (*before.placements, *before.primitives)}
    return (
        tuple(p for p in now.placements if id(p) not in kept),
        tuple(p for p in now.primitives if id(p) not in kept),
    )


def _poses(
    placements: Sequence[Placement], primitives: Sequence[Primitive], ids: NDArray[np.uint32]
) -> dict[int, FloatArray]:
    """Return T_map_object by instance id, for those among ``ids``."""
    poses = {p.instance_id: p.T_map_object for p in primitives if p.instance_id in ids}
    for placement in placements:
        rows = np.flatnonzero(np.isin(placement.instance_ids, ids))
        of_rows = placement.instance_ids[rows].tolist()
        poses.update(zip(of_rows, placement.T_map_object[rows], strict=True))
    return poses
