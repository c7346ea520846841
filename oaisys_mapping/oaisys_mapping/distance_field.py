"""Euclidean distance fields of boxes, for planners.

A TSDF holds distances only near the surface, and along rays. Here every known voxel gets its
Euclidean distance to the surface by an exact distance transform (Felzenszwalb and Huttenlocher,
Theory of Computing 8, 2012), corrected by the signed distances of voxels at the surface, as voxblox
seeds its field (Oleynikova et al., IROS 2017), so that the surface lies between voxels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, ShortRepr
from oaisys_mapping.tsdf import TsdfVolume
from oaisys_mapping.voxels.voxel_queries import ObservedVoxels


@dataclass(frozen=True, repr=False)
class DistanceField(ShortRepr):
    """Distances in a box of voxels.

    Attributes:
        origin_m: (3,) position of the first voxel's sample in ``map``.
        voxel_size_m: Distance between samples.
        distance_m: (X, Y, Z) float32 distance to the nearest surface, negative inside; NaN where
            nothing is known, ``+inf`` if there is no surface in the box.
    """

    origin_m: FloatArray
    voxel_size_m: float
    distance_m: NDArray[np.float32]

    def at(self, points_m: ArrayLike) -> FloatArray:
        """Return the (N,) trilinearly interpolated distances at (N, 3) points.

        They are NaN outside the box and beside unknown voxels.
        """
        points = np.asarray(points_m, np.float64).reshape(-1, 3)
        places = ((points - self.origin_m) / self.voxel_size_m).T
        # Rounding keeps unknown neighbours out of the mean at points on a voxel's sample.
        places = np.where(np.abs(places - np.rint(places)) < 1e-6, np.rint(places), places)
        last = np.array(self.distance_m.shape)[:, None] - 1
        is_inside = ((places >= 0) & (places <= last)).all(axis=0)
        low = np.clip(np.floor(places).astype(np.intp), 0, last)
        found = np.zeros(len(points))
        for corner in range(8):
            ahead = np.array([[corner & 1], [corner >> 1 & 1], [corner >> 2]])
            share = np.where(ahead, places - low, 1 - (places - low)).prod(axis=0)
            value = self.distance_m[tuple(np.minimum(low + ahead, last))]
            with np.errstate(invalid="ignore"):
                found += np.where(share > 0, share * value, 0.0)
        return np.where(is_inside, found, np.nan)

    def slice_at(self, height_m: float) -> FloatArray:
        """Return the (X, Y) distances at a height, on the grid of the box's voxels.

        Raises:
            InvalidInputError: The height lies outside the box.
        """
        columns, rows = self.distance_m.shape[:2]
        top_m = self.origin_m[2] + (self.distance_m.shape[2] - 1) * self.voxel_size_m
        if not self.origin_m[2] <= height_m <= top_m:
            raise InvalidInputError("height_m", height_m, f"{self.origin_m[2]:g} to {top_m:g}")
        x, y = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
        points_m = self.origin_m + self.voxel_size_m * np.stack((x, y, np.zeros_like(x)), axis=-1)
        points_m[..., 2] = height_m
        return self.at(points_m).reshape(columns, rows)


def distance_field(
    volume: TsdfVolume,
    low_m: ArrayLike,
    high_m: ArrayLike,
    *,
    unknown_is_occupied: bool = False,
) -> DistanceField:
    """Return the distances in a box to the surface in that box.

    Surfaces outside the box are ignored, so enlarge it by the greatest distance that matters.

    Args:
        volume: The map; with ``record_free_space`` open space is known too.
        low_m, high_m: (3,) corners of the box.
        unknown_is_occupied: Whether unknown space counts as an obstacle: free voxels get the
            distance to the nearest unknown one if it is smaller.

    Raises:
        InvalidInputError: The box is empty or too large.
    """
    size_m = volume.config.voxel_size_m
    # The margin includes voxels on the box's faces in spite of rounding.
    low = np.ceil(np.asarray(low_m, np.float64) / size_m - 1e-6).astype(np.int64)
    high = np.floor(np.asarray(high_m, np.float64) / size_m + 1e-6).astype(np.int64) + 1
    observed = volume.observations(low, high)
    distance_m = _with_sign(observed, size_m)
    if unknown_is_occupied and not observed.is_known.all():
        away_m = distance_transform_edt(observed.is_known, sampling=size_m)
        is_free = distance_m > 0
        distance_m[is_free] = np.minimum(distance_m, away_m)[is_free]
    distance_m[~observed.is_known] = np.nan
    return DistanceField(low * size_m, size_m, distance_m.astype(np.float32))


def _with_sign(observed: ObservedVoxels, size_m: float) -> FloatArray:
    """Return distances, positive in front of the surface and negative behind it."""
    is_inside = observed.is_known & (observed.distance_m < 0)
    is_outside = observed.is_known & ~is_inside
    own_m = np.minimum(np.abs(observed.distance_m), size_m)
    outside_m = _to_surface(is_outside, is_inside, own_m, size_m)
    inside_m = _to_surface(is_inside, is_outside, own_m, size_m)
    return np.where(is_inside, -inside_m, outside_m)


def _to_surface(
    is_here: NDArray[np.bool_],
    is_beyond: NDArray[np.bool_],
    own_m: NDArray[np.float32],
    size_m: float,
) -> FloatArray:
    """Return the distance of voxels on one side to the surface between the two sides.

    It is the smaller of two: the distance to the nearest voxel beyond the surface minus that
    voxel's own distance, or to the nearest voxel before it plus that voxel's own.
    """
    if not is_beyond.any():
        return np.full(is_here.shape, np.inf)
    away_m, nearest = distance_transform_edt(~is_beyond, sampling=size_m, return_indices=True)
    found_m = away_m - own_m[tuple(nearest)]
    is_border = is_here & (away_m <= size_m * 1.001)
    if is_border.any():
        back_m, nearest = distance_transform_edt(~is_border, sampling=size_m, return_indices=True)
        found_m = np.minimum(found_m, back_m + own_m[tuple(nearest)])
    return np.asarray(np.maximum(found_m, 0))
