"""Queries of a volume at points and in boxes of voxels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray
from oaisys_mapping.voxels.block_cache import BlockCache
from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    VOXELS,
    BlockReader,
    Slots,
    VoxelField,
    block_keys,
    unique_blocks,
)
from oaisys_mapping.voxels.semantic_fusion import most_likely

MAX_BOX_VOXELS = 200_000_000
"""Voxels that a box may have, 5 bytes each."""

BATCH_POINTS = 16_384
"""Points that are processed at a time."""

BATCH_BLOCKS = 4096
"""Blocks that are counted at a time."""

_AHEAD = np.array([(n & 1, n >> 1 & 1, n >> 2) for n in range(8)])


@dataclass(frozen=True)
class ObservedVoxels:
    """The observations in a box of voxels.

    Attributes:
        low: (3,) the first voxel; its sample lies at this times the voxel size.
        distance_m: (X, Y, Z) float32 projective distance to the surface, negative behind it, 0
            where nothing is known.
        is_known: (X, Y, Z) whether the voxel was observed; see `is_observed`.
    """

    low: NDArray[np.int64]
    distance_m: NDArray[np.float32]
    is_known: NDArray[np.bool_]


def is_observed(tsdf: NDArray[Any], weight: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which voxels some view observed, not only assumed to be solid behind a surface."""
    return np.asarray((weight > 0) & (tsdf > -1))


def voxel_observations(
    low: Any, high: Any, truncation_m: float, free_keys: NDArray[np.int64], read: BlockReader
) -> ObservedVoxels:
    """Return the observations of the voxels from ``low`` up to, not including, ``high``.

    Args:
        low, high: (3,) voxels.
        truncation_m: Unit of stored distances, and the distance in free blocks without voxels.
        free_keys: (M,) `block_keys` of blocks known to be free.
        read: Returns voxels.

    Raises:
        InvalidInputError: The box is empty, or too large.
    """
    low, high = np.asarray(low, np.int64), np.asarray(high, np.int64)
    size = high - low
    if (size <= 0).any() or np.prod(size.astype(float)) > MAX_BOX_VOXELS:
        raise InvalidInputError("region", size.tolist(), f"1 to {MAX_BOX_VOXELS} voxels")
    first, last = low // BLOCK_VOXELS, (high - 1) // BLOCK_VOXELS
    grid = np.meshgrid(*map(np.arange, first, last + 1), indexing="ij")
    blocks = np.column_stack([axis.ravel() for axis in grid]).astype(np.int32)
    arrays, slots = read(blocks)
    distance = np.zeros((len(blocks), VOXELS), np.float32)
    is_known = np.zeros((len(blocks), VOXELS), bool)
    exists = slots >= 0
    distance[exists] = arrays["tsdf"][slots[exists]] * np.float32(truncation_m)
    is_known[exists] = is_observed(arrays["tsdf"][slots[exists]], arrays["weight"][slots[exists]])
    is_free = np.isin(block_keys(blocks), free_keys)
    distance[is_free[:, None] & ~is_known] = truncation_m
    is_known[is_free] = True
    distance[~is_known] = 0
    within = tuple(slice(a, b) for a, b in zip(low - first * 8, high - first * 8, strict=True))
    shape = tuple((last - first + 1).tolist())
    return ObservedVoxels(low, _box(distance, shape)[within], _box(is_known, shape)[within])


def volume_observed_m3(cache: BlockCache, free_keys: NDArray[np.int64]) -> float:
    """Return the volume of all observed voxels and of free blocks without voxels."""
    voxels, blocks = 0, cache.all_blocks
    for first in range(0, len(blocks), BATCH_BLOCKS):
        values = cache.values(blocks[first : first + BATCH_BLOCKS])
        voxels += int(is_observed(values["tsdf"], values["weight"]).sum())
    only_free = np.setdiff1d(free_keys, block_keys(blocks))
    block_m = BLOCK_VOXELS * cache.voxel_size_m
    return voxels * cache.voxel_size_m**3 + len(only_free) * block_m**3


@dataclass(frozen=True)
class ClassGrid:
    """Class votes on a grid.

    Attributes:
        cache: The grid's blocks.
        fields: The fields of ids and of weights.
        vote_weight: Factor of the weights.
    """

    cache: BlockCache
    fields: tuple[VoxelField, VoxelField]
    vote_weight: float


def classes_at(
    points_m: FloatArray, grids: Sequence[ClassGrid]
) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
    """Return the (N,) classes of (N, 3) points, and their shares; see `TsdfVolume.classes_at`."""
    points_m = np.asarray(points_m, np.float64).reshape(-1, 3)
    ids = np.zeros(len(points_m), np.uint16)
    shares = np.zeros(len(points_m), np.float32)
    for first in range(0, len(points_m), BATCH_POINTS):
        part = slice(first, first + BATCH_POINTS)
        votes = [_votes_around(points_m[part], grid) for grid in grids]
        voted_ids, weights = (np.hstack(each) for each in zip(*votes, strict=True))
        ids[part], shares[part] = most_likely(voted_ids, weights)
    return ids, shares


def distances_at(
    points_m: FloatArray, voxel_size_m: float, truncation_m: float, read: BlockReader
) -> FloatArray:
    """Return the (N,) distances at (N, 3) points; see `TsdfVolume.distance_at`."""
    points_m = np.asarray(points_m, np.float64).reshape(-1, 3)
    found_m = np.empty(len(points_m))
    for first in range(0, len(points_m), BATCH_POINTS):
        part = slice(first, first + BATCH_POINTS)
        found_m[part] = _distances(points_m[part] / voxel_size_m, read) * truncation_m
    return found_m


def _distances(places: FloatArray, read: BlockReader) -> FloatArray:
    """Return trilinear means of the eight voxels around; NaN where one of them has no value."""
    distance = np.zeros(len(places))
    for share, within, arrays, slots in _corners(places, read):
        value = arrays["tsdf"][slots, within].astype(np.float64)
        value[(slots < 0) | (arrays["weight"][slots, within] <= 0)] = np.nan
        # A corner without a share need not be known.
        distance += np.where(share > 0, value * share, 0)
    return distance


def _votes_around(points_m: FloatArray, grid: ClassGrid) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return (N, M) classes voted for around (N, 3) points, and the weights of the votes."""
    found_ids, found_weights = [], []
    ids, weights = grid.fields
    places = points_m / grid.cache.voxel_size_m
    for share, within, arrays, slots in _corners(places, grid.cache.read):
        factor = (share * (slots >= 0) * grid.vote_weight).astype(np.float32)
        found_weights.append(arrays[weights.name][slots, within] * factor[:, None])
        found_ids.append(arrays[ids.name][slots, within])
    return np.hstack(found_ids), np.hstack(found_weights)


def _corners(
    places: FloatArray, read: BlockReader
) -> Iterable[tuple[FloatArray, NDArray[np.int64], Mapping[str, NDArray[Any]], Slots]]:
    """Yield share and location of each of the eight voxels around (N, 3) places, in voxels."""
    corner = np.floor(places).astype(np.int64)
    along = places - corner
    voxels = corner.T[:, None] + _AHEAD.T[..., None]
    blocks, index = unique_blocks((voxels // BLOCK_VOXELS).reshape(3, -1))
    arrays, slots = read(blocks)
    slots = slots[index].reshape(len(_AHEAD), -1)
    within = np.tensordot((1, BLOCK_VOXELS, BLOCK_VOXELS**2), voxels % BLOCK_VOXELS, 1)
    for number, ahead in enumerate(_AHEAD):
        share = np.where(ahead, along, 1 - along).prod(axis=1)
        yield share, within[number], arrays, slots[number]


def _box(rows: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the voxels of consecutive blocks as one box indexed by x, y, z."""
    cubes = rows.reshape(*shape, BLOCK_VOXELS, BLOCK_VOXELS, BLOCK_VOXELS)
    box = cubes.transpose(0, 5, 1, 4, 2, 3)
    return box.reshape([count * BLOCK_VOXELS for count in shape])
