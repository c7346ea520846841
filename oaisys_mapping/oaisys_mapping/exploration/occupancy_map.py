"""An occupancy map of free, occupied and unknown voxels, with the quality of their observation.

The map is built from depth images and their poses alone. A voxel is free if its centre lies in
front of the surface in the pixel that it projects to, and occupied if it contains a pixel's point.
Occupied voxels stay occupied, as the world is static.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import depth_to_points, invert, unproject
from oaisys_core.types import FloatArray, PinholeIntrinsics

UNKNOWN, FREE, OCCUPIED = np.uint8(0), np.uint8(1), np.uint8(2)

MAX_VOXELS = 50_000_000
"""Voxels of a map, 0.9 GB in all."""

POINT_STRIDE_PX = 2
"""Step between the pixels and between the rows whose points mark occupied voxels."""


@dataclass(frozen=True)
class Bounds:
    """The axis-aligned box in ``map`` in which a vehicle flies.

    Attributes:
        low_m, high_m: (3,) corners.
    """

    low_m: FloatArray
    high_m: FloatArray

    def __post_init__(self) -> None:
        """Refuse boxes without a volume."""
        corners = np.asarray([self.low_m, self.high_m], np.float64)
        sized = corners.shape == (2, 3) and np.isfinite(corners).all()
        if not (sized and (corners[0] < corners[1]).all()):
            raise InvalidInputError("bounds", corners.tolist(), "a finite box, low below high")


class OccupancyMap:
    """A dense grid of voxels over a box.

    Attributes:
        bounds: The box, enlarged at its high side to whole voxels.
        voxel_size_m: Edge length of a voxel.
        state: (X, Y, Z) uint8 `UNKNOWN`, `FREE` or `OCCUPIED`.
        quality: (X, Y, Z) float32, 0 to 1: best quality at which the surface in a voxel was
            observed; see `surface_quality`.
        normals: (X, Y, Z, 3) float32: sum of the normals observed there, of any length.
    """

    def __init__(self, bounds: Bounds, voxel_size_m: float) -> None:
        """Create a map in which everything is unknown.

        Raises:
            InvalidInputError: The voxel size is not positive, or there would be too many voxels.
        """
        if not (np.isfinite(voxel_size_m) and voxel_size_m > 0):
            raise InvalidInputError("voxel_size_m", voxel_size_m, "a finite number above 0")
        low_m = np.asarray(bounds.low_m, np.float64)
        size_m = np.asarray(bounds.high_m, np.float64) - low_m
        shape = tuple(int(n) for n in np.ceil(size_m / voxel_size_m - 1e-9))
        if np.prod(shape, dtype=np.float64) > MAX_VOXELS:
            expected = f"voxels of which at most {MAX_VOXELS} fill the box"
            raise InvalidInputError("voxel_size_m", voxel_size_m, expected)
        self.voxel_size_m = voxel_size_m
        self.bounds = Bounds(low_m, low_m + np.asarray(shape) * voxel_size_m)
        self.state = np.full(shape, UNKNOWN)
        self.quality = np.zeros(shape, np.float32)
        self.normals = np.zeros((*shape, 3), np.float32)

    def integrate(
        self,
        depth_m: NDArray[np.float32],
        intrinsics: PinholeIntrinsics,
        T_map_camera: FloatArray,
        max_range_m: float,
    ) -> None:
        """Integrate one view.

        Args:
            depth_m: (H, W) planar depth; ``+inf`` frees space up to ``max_range_m``, NaN is
                ignored.
            intrinsics: The camera, without distortion.
            T_map_camera: (4, 4) pose of its optical frame.
            max_range_m: Depth beyond which nothing is integrated.
        """
        if not intrinsics.is_rectilinear:
            received = (intrinsics.distortion_model, intrinsics.distortion)
            raise InvalidInputError("intrinsics.distortion", received, "a pinhole without any")
        self._mark_free(depth_m, intrinsics, T_map_camera, max_range_m)
        self._mark_occupied(depth_m, intrinsics, T_map_camera, max_range_m)

    def set_free(self, center_m: ArrayLike, radius_m: float) -> None:
        """Mark the unknown voxels in a ball as free, such as around the vehicle's start."""
        x, y, z = (axis - c for axis, c in zip(self._centers(), np.asarray(center_m), strict=True))
        inside = (
            x[:, None, None] ** 2 + y[None, :, None] ** 2 + z[None, None, :] ** 2 <= radius_m**2
        )
        self.state[inside & (self.state == UNKNOWN)] = FREE

    def clearance_m(self) -> NDArray[np.float32]:
        """Return (X, Y, Z) distances of voxels' centres from the nearest voxel that is not free.

        Space outside the box counts as not free.
        """
        free = np.pad(self.state == FREE, 1)
        distance = ndimage.distance_transform_edt(free, sampling=self.voxel_size_m)
        return np.asarray(distance[1:-1, 1:-1, 1:-1], np.float32)

    def surface_frontier(self) -> NDArray[np.bool_]:
        """Return (X, Y, Z) which unknown voxels touch both free space and an observed surface.

        That is where a surface continues into unobserved space.
        """
        # Voxels inside a slope share edges with free space, so only a shared face counts.
        near_free = ndimage.binary_dilation(self.state == FREE)
        near_surface = ndimage.binary_dilation(self.state == OCCUPIED, np.ones((3, 3, 3), bool))
        return np.asarray((self.state == UNKNOWN) & near_surface & near_free)

    def indices(self, points_m: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return the (N, 3) voxels of (N, 3) points, and (N,) whether these lie in the box."""
        cells = np.floor((points_m - self.bounds.low_m) / self.voxel_size_m).astype(np.intp)
        return cells, np.asarray(((cells >= 0) & (cells < self.state.shape)).all(axis=-1))

    def centers_m(self, cells: NDArray[np.intp]) -> FloatArray:
        """Return the (N, 3) centres of (N, 3) voxels."""
        return np.asarray(self.bounds.low_m + (cells + 0.5) * self.voxel_size_m)

    def _centers(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y, z = (
            low + (np.arange(count) + 0.5) * self.voxel_size_m
            for low, count in zip(self.bounds.low_m, self.state.shape, strict=True)
        )
        return x, y, z

    def _mark_free(
        self,
        depth_m: NDArray[np.float32],
        intrinsics: PinholeIntrinsics,
        T_map_camera: FloatArray,
        max_range_m: float,
    ) -> None:
        """Mark voxels as free whose centres lie in front of the surface that the camera saw."""
        T_camera_map = invert(T_map_camera).astype(np.float32)
        box = self._box_of_view(intrinsics, T_map_camera, max_range_m)
        x, y, z = (
            axis[part].astype(np.float32) for axis, part in zip(self._centers(), box, strict=True)
        )
        # The rotation of a grid is a sum over its axes, so no list of points is needed.
        across, down, ahead = (
            (row[0] * x)[:, None, None]
            + (row[1] * y)[None, :, None]
            + ((row[2] * z) + row[3])[None, None, :]
            for row in T_camera_map[:3]
        )
        state = self.state[box]
        unknown = np.flatnonzero((state == UNKNOWN) & (ahead > 1e-3) & (ahead <= max_range_m))
        z_m = ahead.reshape(-1)[unknown]
        u = np.rint(across.reshape(-1)[unknown] / z_m * intrinsics.fx_px + intrinsics.cx_px)
        v = np.rint(down.reshape(-1)[unknown] / z_m * intrinsics.fy_px + intrinsics.cy_px)
        inside = (u >= 0) & (u < intrinsics.width_px) & (v >= 0) & (v < intrinsics.height_px)
        pixels = v[inside].astype(np.intp) * intrinsics.width_px + u[inside].astype(np.intp)
        # Comparisons with NaN are false, so nothing is freed there.
        before = depth_m.reshape(-1)[pixels] > z_m[inside]
        free = np.unravel_index(unknown[inside][before], state.shape)
        state[free] = FREE

    def _box_of_view(
        self, intrinsics: PinholeIntrinsics, T_map_camera: FloatArray, max_range_m: float
    ) -> tuple[slice, slice, slice]:
        """Return the part of the grid that contains everything a camera can see."""
        edges = [(u, v) for u in (0, intrinsics.width_px) for v in (0, intrinsics.height_px)]
        far_m = unproject(edges, [max_range_m] * len(edges), intrinsics)
        corners_m = np.vstack((np.zeros(3), far_m)) @ T_map_camera[:3, :3].T
        corners_m += T_map_camera[:3, 3]
        low, high = (
            np.floor((corner - self.bounds.low_m) / self.voxel_size_m)
            for corner in (corners_m.min(axis=0), corners_m.max(axis=0))
        )
        starts = np.clip(low, 0, self.state.shape).astype(int)
        ends = np.clip(high + 1, 0, self.state.shape).astype(int)
        x, y, z = (slice(a, b) for a, b in zip(starts, ends, strict=True))
        return x, y, z

    def _mark_occupied(
        self,
        depth_m: NDArray[np.float32],
        intrinsics: PinholeIntrinsics,
        T_map_camera: FloatArray,
        max_range_m: float,
    ) -> None:
        """Mark voxels as occupied that contain points, and update their quality and normals."""
        points_m = depth_to_points(depth_m, intrinsics).astype(np.float64)
        normals = _image_normals(points_m)
        stride = (slice(None, None, POINT_STRIDE_PX),) * 2
        points_m, normals = points_m[stride].reshape(-1, 3), normals[stride].reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            is_valid = np.isfinite(points_m).all(axis=1) & (points_m[:, 2] <= max_range_m)
        points_m, normals = points_m[is_valid], normals[is_valid]
        R = T_map_camera[:3, :3]
        cells, inside = self.indices(points_m @ R.T + T_map_camera[:3, 3])
        cells = cells[inside]
        flat = np.ravel_multi_index(tuple(cells.T), self.state.shape)
        self.state.reshape(-1)[flat] = OCCUPIED
        distances_m = np.linalg.norm(points_m[inside], axis=1)
        cosines = -(normals[inside] * points_m[inside]).sum(axis=1) / distances_m
        known = np.isfinite(cosines)
        quality = surface_quality(distances_m[known], cosines[known]).astype(np.float32)
        np.maximum.at(self.quality.reshape(-1), flat[known], quality)
        in_map = (normals[inside][known] @ R.T).astype(np.float32)
        for axis in range(3):
            sums = np.bincount(flat[known], in_map[:, axis], minlength=0)
            self.normals[..., axis].reshape(-1)[: len(sums)] += sums.astype(np.float32)


FULL_QUALITY_M = 8.0
"""Distance below which the quality of an observation does not grow any further."""


def surface_quality(distances_m: FloatArray, cosines: FloatArray) -> FloatArray:
    """Return the quality of observations of surfaces, 0 to 1, from distances and incidence cosines.

    The number of pixels per area is proportional to the cosine of the angle of incidence and to the
    inverse square of the distance.
    """
    near = np.minimum(1.0, (FULL_QUALITY_M / np.maximum(distances_m, 1e-6)) ** 2)
    return np.asarray(np.clip(cosines, 0.0, 1.0) * near)


def _image_normals(points_m: FloatArray) -> FloatArray:
    """Return the (H, W, 3) unit normals of an image's points, towards the camera, or NaN."""
    right = np.full_like(points_m, np.nan)
    below = np.full_like(points_m, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        right[:, :-1] = points_m[:, 1:] - points_m[:, :-1]
        below[:-1] = points_m[1:] - points_m[:-1]
        normals = np.cross(below, right)
        return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))
