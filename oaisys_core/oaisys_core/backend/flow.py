"""Optical flow from geometry: where each point was in the image of the previous sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.surface import View
from oaisys_core.geometry import invert, project
from oaisys_core.scene import PlacedCamera, Placement, Primitive, Scene
from oaisys_core.types import FloatArray


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
        then = earlier_m @ T_previous_map[:3, :3].T + T_previous_map[:3, 3]
        then[~view.is_hit] = view.directions[~view.is_hit] @ T_previous_map[:3, :3].T
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
        placements, primitives = _changed(now, before)
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
            points_m[pixels] = points_m[pixels] @ T[:3, :3].T + T[:3, 3]


def _changed(
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
