"""Blocks of voxels by their place: Open3D's ``VoxelBlockGrid``, its buffers seen as numpy arrays.

A block is a cube of `BLOCK_VOXELS` voxels along each edge; block (i, j, k) begins at voxel
``BLOCK_VOXELS * (i, j, k)``. Voxel (x, y, z) of a block is number ``x + 8 y + 64 z`` in it, as in
Open3D, and its sample lies at the voxel's lower corner: voxel (0, 0, 0) of block (0, 0, 0) at the
map's origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray

BLOCK_VOXELS = 8
"""Voxels along a block's edge: 8 takes half the time and memory of 16 on terrain."""

VOXELS = BLOCK_VOXELS**3
"""Voxels of a block."""

PART_BLOCKS = 256
"""Blocks that are moved at a time."""

INITIAL_BLOCKS = 10_000
"""Blocks reserved at first, 12 kB each: 30 nadir views at 0.1 m use 5,500. More come by
themselves, by doubling, and the surface does not depend on when."""

MOST_BLOCKS_AWAY = 1 << 16
"""Blocks lie less than this many from the origin: 52 km at 0.1 m."""

MOST_BLOCKS_IN_TABLE = 4_000_000
"""Blocks of a box whose numbers are looked up in a table of 32 MB."""

_CPU = o3d.core.Device("CPU:0")

Coordinates = NDArray[np.int32]
Slots = NDArray[np.int32]


@dataclass(frozen=True)
class VoxelField:
    """What is kept of every voxel under one name.

    Attributes:
        dtype: ``float32`` or ``uint16``.
        channels: Numbers per voxel.
    """

    name: str
    dtype: str
    channels: int = 1

    @property
    def block_bytes(self) -> int:
        """Memory of one block."""
        return VOXELS * self.channels * np.dtype(self.dtype).itemsize


GEOMETRY_FIELDS = (
    VoxelField("tsdf", "float32"),
    VoxelField("weight", "float32"),
    VoxelField("color", "float32", 4),
)


class VoxelBlocks:
    """The blocks that are in memory.

    Args:
        voxel_size_m: Edge length of a voxel.
        fields: Of a voxel.
        most_blocks: How many there will be at most; memory is asked for by doubling up to them.
        initial_blocks: How many memory is reserved for at first.

    Attributes:
        arrays: By field, (capacity, `VOXELS`) or (capacity, `VOXELS`, channels), indexed by slot.
            `add` may replace them.
    """

    def __init__(
        self,
        voxel_size_m: float,
        fields: tuple[VoxelField, ...],
        most_blocks: int,
        initial_blocks: int = INITIAL_BLOCKS,
    ) -> None:
        self.fields = fields
        self._most_blocks = most_blocks
        self.arrays: dict[str, NDArray[Any]] = {}
        self._voxel_size_m = voxel_size_m
        self._make_grid(min(initial_blocks, most_blocks))
        self._known: tuple[Coordinates, Slots] = (np.zeros((0, 3), np.int32), np.zeros(0, np.int32))

    def __len__(self) -> int:
        """Return how many blocks there are."""
        return int(self._map.size())

    def find(self, coordinates: Coordinates) -> Slots:
        """Return the (N,) slots of (N, 3) blocks, -1 where there is none."""
        if not len(coordinates):
            return np.zeros(0, np.int32)
        slots, is_there = self._map.find(_tensor(coordinates))
        return np.where(is_there.numpy(), slots.numpy(), -1).astype(np.int32)

    def add(self, coordinates: Coordinates) -> Slots:
        """Return the (N,) slots of (N, 3) different blocks; those that were missing are zero."""
        missing = coordinates[self.find(coordinates) < 0]
        if len(missing):
            needed, room = len(self) + len(missing), int(self._map.capacity())
            if needed > room:
                self._grow(max(needed, min(2 * room, self._most_blocks)))
            self._map.activate(_tensor(missing))
            new = self.find(missing)
            for array in self.arrays.values():
                array[new] = 0
            self._known = (
                np.concatenate((self._known[0], missing)),
                np.concatenate((self._known[1], new)),
            )
        return self.find(coordinates)

    def remove(self, coordinates: Coordinates) -> None:
        """Forget (N, 3) blocks."""
        if len(coordinates):
            slots = self.find(coordinates)
            self._map.erase(_tensor(coordinates))
            kept = ~np.isin(self._known[1], slots)
            self._known = (self._known[0][kept], self._known[1][kept])

    def all(self) -> tuple[Coordinates, Slots]:
        """Return the (N, 3) coordinates of all blocks and their (N,) slots, in any order."""
        return self._known

    def near_surface(
        self, depth: Any, K: FloatArray, T_camera_map: FloatArray, most: tuple[float, float]
    ) -> Coordinates:
        """Return the (N, 3) blocks that a depth image shows a surface in or near.

        Args:
            depth: Open3D's image, 0 where nothing is to be mapped.
            K: (3, 3) of the camera.
            T_camera_map: (4, 4).
            most: Greatest depth in metres, and truncation in voxels.
        """
        max_range_m, truncation_voxels = most
        found = self._grid.compute_unique_block_coordinates(
            depth,
            o3d.core.Tensor(K),
            o3d.core.Tensor(T_camera_map),
            1.0,
            float(max_range_m),
            float(truncation_voxels),
        )
        return np.asarray(found.numpy())

    def _make_grid(self, capacity: int) -> None:
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            tuple(field.name for field in self.fields),
            tuple(getattr(o3d.core, field.dtype) for field in self.fields),
            tuple((field.channels) for field in self.fields),
            self._voxel_size_m,
            BLOCK_VOXELS,
            capacity,
            _CPU,
        )
        self._map = self._grid.hashmap()
        for index, field in enumerate(self.fields):
            shape = (VOXELS,) if field.channels == 1 else (VOXELS, field.channels)
            buffer = self._map.value_tensor(index).numpy()
            self.arrays[field.name] = buffer.reshape(len(buffer), *shape)

    def _grow(self, capacity: int) -> None:
        """Move to a larger grid. Open3D's own way takes seconds: it copies number by number."""
        (coordinates, slots), old, arrays = self._known, self._grid, dict(self.arrays)
        self._make_grid(capacity)
        if len(coordinates):
            self._map.activate(_tensor(coordinates))
        found = self.find(coordinates)
        for name, array in arrays.items():
            for first in range(0, len(slots), PART_BLOCKS):
                part = slice(first, first + PART_BLOCKS)
                self.arrays[name][found[part]] = array[slots[part]]
        self._known = (coordinates, found)
        del old  # only now: its memory was read


def block_order(coordinates: Coordinates) -> NDArray[np.intp]:
    """Return the (N,) order of (N, 3) blocks by x, then y, then z."""
    return np.argsort(packed(coordinates), kind="stable")


def distinct_blocks(blocks: NDArray[Any]) -> tuple[Coordinates, NDArray[np.intp]]:
    """Return the different ones of (3, N) blocks, (M, 3) in `block_order`, and each's number.

    Those in a box of a few million are told apart by a table of it, which takes no sorting.
    """
    if not blocks.size:
        return np.zeros((0, 3), np.int32), np.zeros(0, np.intp)
    low, high = blocks.min(axis=1), blocks.max(axis=1)
    size = high.astype(np.int64) - low + 1
    if np.prod(size.astype(float)) > MOST_BLOCKS_IN_TABLE:
        numbers, place = np.unique(packed(blocks.T), return_inverse=True)
        return unpacked(numbers), place.ravel()
    steps = np.array((size[1] * size[2], size[2], 1), blocks.dtype)
    number = blocks[0] * steps[0] + blocks[1] * steps[1] + blocks[2] - low @ steps
    table = np.zeros(np.prod(size), np.intp)
    table[number] = 1
    found = np.flatnonzero(table)
    table[found] = np.arange(len(found))
    coordinates = np.column_stack(np.unravel_index(found, size)) + low
    return coordinates.astype(np.int32), table[number]


def packed(coordinates: NDArray[Any]) -> NDArray[np.int64]:
    """Return one number for each of (N, 3) blocks, in their order; inverse: `unpacked`.

    Raises:
        InvalidInputError: One lies further away than numbers reach.
    """
    apart = np.asarray(coordinates, np.int64).reshape(-1, 3) + MOST_BLOCKS_AWAY
    if len(apart) and (apart.min() < 0 or apart.max() >= 2 * MOST_BLOCKS_AWAY):
        raise InvalidInputError(
            "T_map_camera", coordinates.tolist()[0], f"a map within {MOST_BLOCKS_AWAY} blocks"
        )
    x, y, z = apart.T
    return np.asarray((x << 34) | (y << 17) | z)


def unpacked(numbers: NDArray[np.int64]) -> Coordinates:
    """Return the (N, 3) blocks of (N,) numbers; inverse: `packed`."""
    mask = 2 * MOST_BLOCKS_AWAY - 1
    apart: NDArray[np.int64] = np.column_stack(
        (numbers >> 34, numbers >> 17 & mask, numbers & mask)
    )
    return (apart - MOST_BLOCKS_AWAY).astype(np.int32)


def block_bytes(fields: tuple[VoxelField, ...]) -> int:
    """Return the memory of one block."""
    return sum(field.block_bytes for field in fields)


def _tensor(coordinates: Coordinates) -> Any:
    return o3d.core.Tensor(np.ascontiguousarray(coordinates, np.int32))
