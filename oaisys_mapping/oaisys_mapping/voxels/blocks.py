"""Voxel blocks in memory: Open3D's ``VoxelBlockGrid``, with its buffers as numpy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    NO_BLOCKS,
    BlockCoordinates,
    Slots,
    VoxelField,
)

COPIED_BLOCKS = 256
"""Blocks that are copied at a time when the grid grows."""

INITIAL_BLOCKS = 10_000
"""Blocks reserved at first, 12 kB each; the grid grows by doubling."""

SEARCH_STRIDE_PX = 4
"""Open3D searches every fourth pixel for a surface, and raises where all of these are empty."""

_CPU = o3d.core.Device("CPU:0")


class VoxelBlocks:
    """The blocks in memory.

    Args:
        voxel_size_m: Edge length of a voxel.
        fields: Values stored for each voxel.
        max_blocks: How many blocks there will be at most.
        initial_blocks: How many to reserve memory for at first; None: `INITIAL_BLOCKS`.

    Attributes:
        arrays: By field, (capacity, `VOXELS`) or (capacity, `VOXELS`, channels), indexed by slot.
            `add` may replace them.
    """

    def __init__(
        self,
        voxel_size_m: float,
        fields: tuple[VoxelField, ...],
        max_blocks: int,
        initial_blocks: int | None = None,
    ) -> None:
        self.fields = fields
        self._max_blocks = max_blocks
        self.arrays: dict[str, NDArray[Any]] = {}
        self._voxel_size_m = voxel_size_m
        self._make_grid(min(initial_blocks or INITIAL_BLOCKS, max_blocks))
        self._known: tuple[BlockCoordinates, Slots] = (NO_BLOCKS, np.zeros(0, np.int32))

    def __len__(self) -> int:
        """Return how many blocks there are."""
        return int(self._map.size())

    def find(self, blocks: BlockCoordinates) -> Slots:
        """Return the (N,) slots of (N, 3) blocks, -1 for those that do not exist."""
        if not len(blocks):
            return np.zeros(0, np.int32)
        slots, exists = self._map.find(_tensor(blocks))
        return np.where(exists.numpy(), slots.numpy(), -1).astype(np.int32)

    def add(self, blocks: BlockCoordinates) -> Slots:
        """Return the (N,) slots of (N, 3) different blocks; new blocks are filled with zeros."""
        missing = blocks[self.find(blocks) < 0]
        if len(missing):
            needed, capacity = len(self) + len(missing), int(self._map.capacity())
            if needed > capacity:
                self._grow(max(needed, min(2 * capacity, self._max_blocks)))
            self._map.activate(_tensor(missing))
            new = self.find(missing)
            for array in self.arrays.values():
                array[new] = 0
            self._known = (
                np.concatenate((self._known[0], missing)),
                np.concatenate((self._known[1], new)),
            )
        return self.find(blocks)

    def remove(self, blocks: BlockCoordinates) -> None:
        """Remove (N, 3) blocks."""
        if len(blocks):
            slots = self.find(blocks)
            self._map.erase(_tensor(blocks))
            kept = ~np.isin(self._known[1], slots)
            self._known = (self._known[0][kept], self._known[1][kept])

    def all(self) -> tuple[BlockCoordinates, Slots]:
        """Return the (N, 3) coordinates of all blocks and their (N,) slots, in no set order."""
        return self._known

    def near_surface(
        self,
        depth_m: NDArray[np.float32],
        camera: PinholeIntrinsics,
        T_map_camera: FloatArray,
        max_range_m: float,
        truncation_voxels: float,
    ) -> BlockCoordinates:
        """Return the (N, 3) blocks within the truncation of the surface in a depth image."""
        with np.errstate(invalid="ignore"):
            is_near = (depth_m > 0) & (depth_m < max_range_m)
        if not _search_finds_any(is_near):
            return NO_BLOCKS
        shown_m = np.where(is_near, depth_m, np.float32(0))
        found = self._grid.compute_unique_block_coordinates(
            o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(shown_m, np.float32))),
            o3d.core.Tensor(camera.K),
            o3d.core.Tensor(invert(T_map_camera)),
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
            buffer = self._map.value_tensor(index).numpy()
            self.arrays[field.name] = buffer.reshape(len(buffer), *field.shape)

    def _grow(self, capacity: int) -> None:
        """Move to a larger grid; Open3D's own growth copies value by value and takes seconds."""
        (blocks, slots), old_grid, old_arrays = self._known, self._grid, dict(self.arrays)
        self._make_grid(capacity)
        if len(blocks):
            self._map.activate(_tensor(blocks))
        new_slots = self.find(blocks)
        for name, array in old_arrays.items():
            for first in range(0, len(slots), COPIED_BLOCKS):
                part = slice(first, first + COPIED_BLOCKS)
                self.arrays[name][new_slots[part]] = array[slots[part]]
        self._known = (blocks, new_slots)
        del old_grid  # The old arrays are views of its memory.


def _search_finds_any(is_near: NDArray[np.bool_]) -> bool:
    height, width = (size // SEARCH_STRIDE_PX * SEARCH_STRIDE_PX for size in is_near.shape)
    return bool(is_near[:height:SEARCH_STRIDE_PX, :width:SEARCH_STRIDE_PX].any())


def _tensor(blocks: BlockCoordinates) -> Any:
    return o3d.core.Tensor(np.ascontiguousarray(blocks, np.int32))
