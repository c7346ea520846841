"""Information gain of views, by casting rays through the voxels of a map.

As in Bircher et al., "Receding horizon next-best-view planner for 3D exploration", ICRA 2016, views
are scored by the unknown volume that they would see. Volume at surface frontiers counts most, and
known surfaces count by the quality that they would gain (Schmid et al., "An efficient
sampling-based method for online informative path planning in unknown environments", RA-L 2020).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.exploration.occupancy_map import (
    OCCUPIED,
    UNKNOWN,
    OccupancyMap,
    surface_quality,
)

RAYS_ACROSS, RAYS_DOWN = 24, 18
"""Rays of a view; each represents its part of the image."""


@dataclass(frozen=True)
class GainWeights:
    """Weights of the gain, per cubic or square metre.

    Attributes:
        frontier: Unknown volume at a surface frontier.
        unknown: Other unknown volume.
        surface: Area of known surface times the quality that it would gain.
    """

    frontier: float = 1.0
    unknown: float = 0.0005
    surface: float = 0.1


class ViewScorer:
    """Scores views by a map's present state; it must be made again when the map changes."""

    def __init__(
        self,
        voxels: OccupancyMap,
        intrinsics: PinholeIntrinsics,
        max_range_m: float,
        weights: GainWeights | None = None,
    ) -> None:
        self._voxels = voxels
        self._weights = weights or GainWeights()
        self._rays, self._ray_share = _image_rays(intrinsics)
        step_m = voxels.voxel_size_m
        self._depths_m = np.arange(step_m / 2, max_range_m, step_m, dtype=np.float32)
        value = np.zeros(voxels.state.shape, np.float32)
        value[voxels.state == UNKNOWN] = self._weights.unknown
        value[voxels.surface_frontier()] = self._weights.frontier
        self._value = value.reshape(-1)
        self._occupied = (voxels.state == OCCUPIED).reshape(-1)

    def scores(self, T_map_camera: FloatArray) -> FloatArray:
        """Return the (N,) gains of views with optical frames at (N, 4, 4) poses."""
        return np.array([self._score(pose) for pose in T_map_camera])

    def _score(self, T_map_camera: FloatArray) -> float:
        voxels = self._voxels
        directions = (self._rays @ T_map_camera[:3, :3].T).astype(np.float32)
        start = ((T_map_camera[:3, 3] - voxels.bounds.low_m) / voxels.voxel_size_m).astype(
            np.float32
        )
        steps = self._depths_m / np.float32(voxels.voxel_size_m)
        # (D, R) voxel coordinates, axis by axis: a point list would take three times the memory.
        flat = np.zeros((len(steps), len(directions)), np.int32)
        is_inside = np.ones(flat.shape, bool)
        for axis, size in enumerate(voxels.state.shape):
            along = start[axis] + steps[:, None] * directions[None, :, axis]
            is_inside &= (along >= 0) & (along < size)
            np.clip(along, 0, size - 1, out=along)
            flat *= size
            flat += along.astype(np.int32)
        is_blocked = self._occupied[flat] & is_inside
        hit = is_blocked.any(axis=0)
        first = np.where(hit, is_blocked.argmax(axis=0), len(steps))
        is_visible = is_inside & (np.arange(len(steps))[:, None] < first)
        # The cross-section that a ray represents grows with the square of the depth.
        volume_m3 = self._ray_share * self._depths_m**2 * voxels.voxel_size_m
        gain = float((np.where(is_visible, self._value[flat], 0).sum(axis=1) * volume_m3).sum())
        return gain + self._surface_gain(
            flat[first[hit], np.flatnonzero(hit)], first[hit], directions[hit]
        )

    def _surface_gain(
        self, cells: NDArray[np.int32], depth_steps: NDArray[np.intp], directions: FloatArray
    ) -> float:
        normals = self._voxels.normals.reshape(-1, 3)[cells]
        lengths = np.linalg.norm(normals, axis=1)
        is_known = lengths > 0
        directions, cells = directions[is_known], cells[is_known]
        normals = normals[is_known] / lengths[is_known, None]
        ray_lengths = np.linalg.norm(directions, axis=1)
        cosines = -(normals * directions).sum(axis=1) / ray_lengths
        depths_m = self._depths_m[depth_steps[is_known]]
        improvement = surface_quality(depths_m * ray_lengths, cosines)
        improvement = np.maximum(improvement - self._voxels.quality.reshape(-1)[cells], 0)
        area_m2 = self._ray_share * depths_m**2 / np.clip(cosines, 0.2, 1.0)
        return float(self._weights.surface * (improvement * area_m2).sum())


def _image_rays(intrinsics: PinholeIntrinsics) -> tuple[FloatArray, float]:
    """Return (R, 3) rays with z = 1 through a grid of pixels, and the area of each at z = 1."""
    u = (np.arange(RAYS_ACROSS) + 0.5) / RAYS_ACROSS * intrinsics.width_px - 0.5
    v = (np.arange(RAYS_DOWN) + 0.5) / RAYS_DOWN * intrinsics.height_px - 0.5
    across, down = np.meshgrid(
        (u - intrinsics.cx_px) / intrinsics.fx_px, (v - intrinsics.cy_px) / intrinsics.fy_px
    )
    rays = np.stack((across, down, np.ones_like(across)), axis=-1).reshape(-1, 3)
    size = intrinsics.width_px / intrinsics.fx_px * intrinsics.height_px / intrinsics.fy_px
    return rays, size / len(rays)
