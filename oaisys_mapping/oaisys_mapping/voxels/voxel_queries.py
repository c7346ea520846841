"""What a volume knows of points and of boxes of voxels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray
from oaisys_mapping.voxels.blocks import (
    BLOCK_VOXELS,
    VOXELS,
    Coordinates,
    Slots,
    distinct_blocks,
    packed,
)
from oaisys_mapping.voxels.semantic_fusion import most_likely

MOST_VOXELS = 200_000_000
"""Voxels that a box may have; one takes 5 bytes."""

PART_POINTS = 16_384

_AHEAD = np.array([(n & 1, n >> 1 & 1, n >> 2) for n in range(8)])

Source = Callable[[Coordinates], tuple[Mapping[str, NDArray[Any]], Slots]]


@dataclass(frozen=True)
class ObservedVoxels:
    """What is known of a box of voxels.

    Attributes:
        low: (3,) the first voxel; its sample lies at this times the voxel's size.
        distance_m: (X, Y, Z) float32 projective distance to the surface, below 0 behind it.
        is_known: (X, Y, Z) whether something was seen there, see `is_seen`; elsewhere the distance
            is 0.
    """

    low: NDArray[np.int64]
    distance_m: NDArray[np.float32]
    is_known: NDArray[np.bool_]


def is_seen(tsdf: NDArray[Any], weight: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which voxels some view told about, not only took for solid: see `fusing.ASSUMED`."""
    return np.asarray((weight > 0) & (tsdf > -1))


def observed_voxels(
    low: Any, high: Any, truncation_m: float, free: NDArray[np.int64], source: Source
) -> ObservedVoxels:
    """Return what is known of the voxels from ``low`` up to, not including, ``high``.

    Args:
        low, high: (3,) voxels.
        truncation_m: What a stored distance of 1 means, and that of free blocks without voxels.
        free: (M,) packed blocks that are known to be free.
        source: Gives voxels.

    Raises:
        InvalidInputError: The box is empty, or too large.
    """
    low, high = np.asarray(low, np.int64), np.asarray(high, np.int64)
    size = high - low
    if (size <= 0).any() or np.prod(size.astype(float)) > MOST_VOXELS:
        raise InvalidInputError("region", size.tolist(), f"1 to {MOST_VOXELS} voxels")
    first, last = low // BLOCK_VOXELS, (high - 1) // BLOCK_VOXELS
    grid = np.meshgrid(*map(np.arange, first, last + 1), indexing="ij")
    blocks = np.column_stack([axis.ravel() for axis in grid]).astype(np.int32)
    arrays, slots = source(blocks)
    distance = np.zeros((len(blocks), VOXELS), np.float32)
    is_known = np.zeros((len(blocks), VOXELS), bool)
    there = slots >= 0
    distance[there] = arrays["tsdf"][slots[there]] * np.float32(truncation_m)
    is_known[there] = is_seen(arrays["tsdf"][slots[there]], arrays["weight"][slots[there]])
    is_free = np.isin(packed(blocks), free)
    distance[is_free[:, None] & ~is_known] = truncation_m
    is_known[is_free] = True
    distance[~is_known] = 0
    within = tuple(slice(a, b) for a, b in zip(low - first * 8, high - first * 8, strict=True))
    shape = tuple((last - first + 1).tolist())
    return ObservedVoxels(low, _box(distance, shape)[within], _box(is_known, shape)[within])


@dataclass(frozen=True)
class ClassVotes:
    """Classes on a grid.

    Attributes:
        size_m: Distance between samples.
        source: Gives them.
        id_field, weight_field: Names of the fields.
        counts: What a vote counts.
    """

    size_m: float
    source: Source
    id_field: str
    weight_field: str
    counts: float


def classes_at(
    points_m: FloatArray, votes: Sequence[ClassVotes]
) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
    """Return the (N,) classes of (N, 3) points, and their shares; see `TsdfVolume.classes_at`."""
    points_m = np.asarray(points_m, np.float64).reshape(-1, 3)
    ids = np.zeros(len(points_m), np.uint16)
    shares = np.zeros(len(points_m), np.float32)
    for first in range(0, len(points_m), PART_POINTS):
        part = slice(first, first + PART_POINTS)
        told = [_told(points_m[part], grid) for grid in votes]
        some_ids, weights = (np.hstack(each) for each in zip(*told, strict=True))
        ids[part], shares[part] = most_likely(some_ids, weights)
    return ids, shares


def distances_at(
    points_m: FloatArray, voxel_size_m: float, truncation_m: float, source: Source
) -> FloatArray:
    """Return the (N,) distances at (N, 3) points; see `TsdfVolume.distance_at`."""
    points_m = np.asarray(points_m, np.float64).reshape(-1, 3)
    found_m = np.empty(len(points_m))
    for first in range(0, len(points_m), PART_POINTS):
        part = slice(first, first + PART_POINTS)
        found_m[part] = _distances(points_m[part] / voxel_size_m, source) * truncation_m
    return found_m


def _distances(places: FloatArray, source: Source) -> FloatArray:
    """Return the trilinear mean of the eight voxels around; NaN where one of them has no value."""
    distance = np.zeros(len(places))
    for share, within, arrays, slots in _corners(places, source):
        value = arrays["tsdf"][slots, within].astype(np.float64)
        value[(slots < 0) | (arrays["weight"][slots, within] <= 0)] = np.nan
        # A corner that has no share tells nothing, so it need not be known.
        distance += np.where(share > 0, value * share, 0)
    return distance


def _told(points_m: FloatArray, votes: ClassVotes) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return (N, M) classes told around (N, 3) points, and what each counts."""
    found_ids, found_weights = [], []
    for share, within, arrays, slots in _corners(points_m / votes.size_m, votes.source):
        counts = (share * (slots >= 0) * votes.counts).astype(np.float32)
        found_weights.append(arrays[votes.weight_field][slots, within] * counts[:, None])
        found_ids.append(arrays[votes.id_field][slots, within])
    return np.hstack(found_ids), np.hstack(found_weights)


def _corners(
    places: FloatArray, source: Source
) -> Iterable[tuple[FloatArray, NDArray[np.int64], Mapping[str, NDArray[Any]], Slots]]:
    """Yield, for each of the eight voxels around (N, 3) places in voxels, its share and place."""
    corner = np.floor(places).astype(np.int64)
    along = places - corner
    voxels = corner.T[:, None] + _AHEAD.T[..., None]
    blocks, place = distinct_blocks((voxels // BLOCK_VOXELS).reshape(3, -1))
    arrays, slots = source(blocks)
    slots = slots[place].reshape(len(_AHEAD), -1)
    within = np.tensordot((1, BLOCK_VOXELS, BLOCK_VOXELS**2), voxels % BLOCK_VOXELS, 1)
    for number, ahead in enumerate(_AHEAD):
        share = np.where(ahead, along, 1 - along).prod(axis=1)
        yield share, within[number], arrays, slots[number]


def _box(rows: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return blocks' voxels, one after the other, as one box indexed by x, y, z."""
    cubes = rows.reshape(*shape, BLOCK_VOXELS, BLOCK_VOXELS, BLOCK_VOXELS)
    box = cubes.transpose(0, 5, 1, 4, 2, 3)
    return box.reshape([count * BLOCK_VOXELS for count in shape])
