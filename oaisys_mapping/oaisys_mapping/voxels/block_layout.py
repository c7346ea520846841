"""The layout of voxel blocks: their coordinates, and the values stored for each voxel.

A block is a cube of `BLOCK_VOXELS` voxels along each edge; block (i, j, k) begins at voxel
``BLOCK_VOXELS * (i, j, k)``. Voxel (x, y, z) of a block is number ``x + 8 y + 64 z`` in it, as in
Open3D, and its sample lies at the voxel's lower corner: voxel (0, 0, 0) of block (0, 0, 0) at the
map's origin.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError

BLOCK_VOXELS = 8
"""Voxels along a block's edge; on terrain 8 takes half the time and memory of 16."""

VOXELS = BLOCK_VOXELS**3
"""Voxels in a block."""

CLASSES_KEPT = 4
"""Classes that a voxel keeps."""

CELL_CLASSES_KEPT = 2
"""Classes that a label cell keeps: one border may run through it."""

CELL_BLOCKS_PER_BLOCK = 4
"""Blocks of label cells allowed for each block of voxels; rocky terrain uses 2.5 of 8 possible."""

MAX_COORDINATE = 1 << 16
"""Block coordinates are smaller than this in magnitude: 52 km at 0.1 m."""

MAX_TABLE_BLOCKS = 4_000_000
"""Size of the bounding box, in blocks, up to which `unique_blocks` uses a table (32 MB)."""

BlockCoordinates = NDArray[np.int32]
"""(N, 3) blocks."""

Slots = NDArray[np.int32]
"""(N,) where blocks lie in memory; -1 for a block that does not exist."""

BlockReader = Callable[[BlockCoordinates], tuple[Mapping[str, NDArray[Any]], Slots]]
"""Returns the arrays of voxel fields, and the slots of (N, 3) blocks in them."""

NO_BLOCKS: BlockCoordinates = np.zeros((0, 3), np.int32)


@dataclass(frozen=True)
class VoxelField:
    """A value stored for every voxel under one name.

    Attributes:
        dtype: ``float32`` or ``uint16``.
        channels: Numbers per voxel.
    """

    name: str
    dtype: str
    channels: int = 1

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one block's values: (`VOXELS`,) or (`VOXELS`, channels)."""
        return (VOXELS,) if self.channels == 1 else (VOXELS, self.channels)

    @property
    def block_bytes(self) -> int:
        """Memory of one block's values."""
        return VOXELS * self.channels * np.dtype(self.dtype).itemsize


GEOMETRY_FIELDS = (
    VoxelField("tsdf", "float32"),
    VoxelField("weight", "float32"),
    VoxelField("color", "float32", 4),
)
SEMANTIC_FIELDS = (
    VoxelField("class_id", "uint16", CLASSES_KEPT),
    VoxelField("class_weight", "float32", CLASSES_KEPT),
)
CELL_FIELDS = (
    VoxelField("cell_class_id", "uint16", CELL_CLASSES_KEPT),
    VoxelField("cell_class_weight", "float32", CELL_CLASSES_KEPT),
)


def block_bytes(fields: tuple[VoxelField, ...]) -> int:
    """Return the memory of one block with these fields."""
    return sum(field.block_bytes for field in fields)


def voxel_offsets() -> NDArray[np.int64]:
    """Return the (`VOXELS`, 3) positions of a block's voxels within it, in the order of memory."""
    number = np.arange(VOXELS)
    return np.column_stack(
        (number % BLOCK_VOXELS, number // BLOCK_VOXELS % BLOCK_VOXELS, number // BLOCK_VOXELS**2)
    )


def block_keys(blocks: NDArray[Any]) -> NDArray[np.int64]:
    """Return one number for each of (N, 3) blocks, ordered by x, y, z; inverse: `blocks_of_keys`.

    Raises:
        InvalidInputError: A block lies too far from the origin.
    """
    shifted = np.asarray(blocks, np.int64).reshape(-1, 3) + MAX_COORDINATE
    if len(shifted) and (shifted.min() < 0 or shifted.max() >= 2 * MAX_COORDINATE):
        raise InvalidInputError(
            "T_map_camera", blocks.tolist()[0], f"a map within {MAX_COORDINATE} blocks"
        )
    x, y, z = shifted.T
    return np.asarray((x << 34) | (y << 17) | z)


def blocks_of_keys(keys: NDArray[np.int64]) -> BlockCoordinates:
    """Return the (N, 3) blocks of (N,) keys; inverse: `block_keys`."""
    mask = 2 * MAX_COORDINATE - 1
    shifted: NDArray[np.int64] = np.column_stack((keys >> 34, keys >> 17 & mask, keys & mask))
    return (shifted - MAX_COORDINATE).astype(np.int32)


def block_order(blocks: BlockCoordinates) -> NDArray[np.intp]:
    """Return the (N,) order that sorts (N, 3) blocks by x, then y, then z."""
    return np.argsort(block_keys(blocks), kind="stable")


def union_of_blocks(blocks: BlockCoordinates, more: BlockCoordinates) -> BlockCoordinates:
    """Return the blocks of both arrays, each once."""
    if not len(more):
        return blocks
    return blocks_of_keys(np.union1d(block_keys(blocks), block_keys(more)))


def unique_blocks(blocks: NDArray[Any]) -> tuple[BlockCoordinates, NDArray[np.intp]]:
    """Return the M different blocks among (3, N), in `block_order`, and each one's index in them.

    Where their bounding box is small enough, a table of the box replaces sorting.
    """
    if not blocks.size:
        return NO_BLOCKS, np.zeros(0, np.intp)
    low, high = blocks.min(axis=1), blocks.max(axis=1)
    size = high.astype(np.int64) - low + 1
    if np.prod(size.astype(float)) > MAX_TABLE_BLOCKS:
        keys, index = np.unique(block_keys(blocks.T), return_inverse=True)
        return blocks_of_keys(keys), index.ravel()
    steps = np.array((size[1] * size[2], size[2], 1), blocks.dtype)
    number = blocks[0] * steps[0] + blocks[1] * steps[1] + blocks[2] - low @ steps
    table = np.zeros(np.prod(size), np.intp)
    table[number] = 1
    found = np.flatnonzero(table)
    table[found] = np.arange(len(found))
    coordinates = np.column_stack(np.unravel_index(found, size)) + low
    return coordinates.astype(np.int32), table[number]
