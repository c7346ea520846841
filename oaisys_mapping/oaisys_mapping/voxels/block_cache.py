"""Voxel blocks in memory with a disk store behind them, and eviction when memory is full."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError
from oaisys_core.types import FloatArray
from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    NO_BLOCKS,
    BlockCoordinates,
    Slots,
    VoxelField,
    block_order,
    union_of_blocks,
)
from oaisys_mapping.voxels.block_store import BlockStore
from oaisys_mapping.voxels.blocks import VoxelBlocks
from oaisys_mapping.voxels.free_space import DepthPyramid

EVICTED_SHARE = 0.1
"""Share of the allowed blocks that is evicted at once when memory is full."""


class VolumeFullError(OaisysError):
    """A view needs more memory than a volume may use."""


def check_capacity(needed: int, max_blocks: int) -> None:
    """Raise `VolumeFullError` where more blocks are needed than allowed."""
    if needed > max_blocks:
        raise VolumeFullError(
            f"the map would need {needed} blocks of {BLOCK_VOXELS}^3 voxels, but only "
            f"{max_blocks} may be used: choose larger voxels or a shorter range"
        )


@dataclass(frozen=True)
class ViewBlocks:
    """The blocks loaded for a view, and what loading them changed.

    Attributes:
        blocks, slots: (N, 3) and (N,) blocks that the view may update.
        restored: (M, 3) blocks read back from disk.
        evicted: (K, 3) blocks that are no longer in memory.
    """

    blocks: BlockCoordinates
    slots: Slots
    restored: BlockCoordinates
    evicted: BlockCoordinates


class BlockCache:
    """A limited number of blocks in memory; evicted ones are dropped or stored on disk.

    Args:
        voxel_size_m: Edge length of a voxel.
        fields: Values stored for each voxel.
        max_blocks: Blocks that may be in memory.
        when_full: One of `config.WHEN_FULL`; blocks farthest from the camera are evicted first.
        store_folder: Folder of the file of stored blocks; None: the system's temporary folder.
        initial_blocks: See `VoxelBlocks`.
    """

    def __init__(
        self,
        voxel_size_m: float,
        fields: tuple[VoxelField, ...],
        *,
        max_blocks: int,
        when_full: str,
        store_folder: Path | None,
        initial_blocks: int | None = None,
    ) -> None:
        self.voxel_size_m = voxel_size_m
        self.fields = fields
        self._max_blocks = max_blocks
        self._when_full = when_full
        self._memory = VoxelBlocks(voxel_size_m, fields, max_blocks, initial_blocks)
        self._store = BlockStore(fields, store_folder)
        self.near_surface = self._memory.near_surface

    @property
    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Fields of the voxels in memory, indexed by slot."""
        return self._memory.arrays

    @property
    def count_in_memory(self) -> int:
        """How many blocks are in memory."""
        return len(self._memory)

    @property
    def count_stored(self) -> int:
        """How many blocks are on disk."""
        return len(self._store)

    @property
    def blocks_in_memory(self) -> BlockCoordinates:
        """The (N, 3) blocks in memory, in no set order."""
        return self._memory.all()[0]

    @property
    def blocks_on_disk(self) -> BlockCoordinates:
        """The (N, 3) blocks on disk."""
        return self._store.blocks

    @property
    def all_blocks(self) -> BlockCoordinates:
        """The (N, 3) blocks in memory and on disk, in `block_order`."""
        both = np.concatenate((self.blocks_in_memory, self._store.blocks))
        return both[block_order(both)]

    def load_view(
        self, near: BlockCoordinates, rays: DepthPyramid | None, camera_m: FloatArray
    ) -> ViewBlocks:
        """Bring the blocks into memory that a view shows a surface in or passes through.

        Args:
            near: (N, 3) blocks near the surface; they are created where missing.
            rays: The view's rays, for the blocks they pass through; None: no such blocks.
            camera_m: (3,) the camera's position.

        Raises:
            VolumeFullError: There is no room; nothing has changed.
        """
        wanted = near
        if len(self._store) and rays is not None:
            stored = self._store.blocks
            wanted = union_of_blocks(near, stored[rays.touches(stored)])
        is_stored = self._store.has(wanted) if len(self._store) else np.zeros(len(wanted), bool)
        evicted = self._make_room(wanted, camera_m)
        slots = self._memory.add(wanted)
        restored = wanted[is_stored]
        if len(restored):
            for name, values in self._store.take(restored).items():
                self._memory.arrays[name][slots[is_stored]] = values
        if rays is not None:
            wanted, slots = self._with_traversed(wanted, slots, rays)
        return ViewBlocks(wanted, slots, restored, evicted)

    def add(self, blocks: BlockCoordinates) -> Slots:
        """Create missing ones of (N, 3) blocks and return the (N,) slots.

        Blocks for which there is no room, the last ones, get slot -1.
        """
        missing = np.flatnonzero(self._memory.find(blocks) < 0)
        no_room = missing[max(0, self._max_blocks - len(self._memory)) :]
        self._memory.add(np.delete(blocks, no_room, axis=0))
        return self._memory.find(blocks)

    def evict(self, blocks: BlockCoordinates, *, store: bool) -> None:
        """Remove those of (N, 3) blocks that are in memory, after storing them if asked to.

        Raises:
            VolumeFullError: The disk is full; the blocks are still in memory.
        """
        evicted = blocks[self._memory.find(blocks) >= 0]
        if store and len(evicted):
            try:
                self._store.put(evicted, self.values(evicted))
            except OSError as error:
                raise VolumeFullError(f"blocks cannot be stored: {error}") from error
        self._memory.remove(evicted)

    def restore(self, blocks: BlockCoordinates) -> None:
        """Move those of (N, 3) blocks that are on disk into memory."""
        stored = blocks[self._store.has(blocks)]
        if len(stored):
            self.insert(stored, self._store.take(stored))

    def insert(self, blocks: BlockCoordinates, values: Mapping[str, NDArray[Any]]) -> None:
        """Add (N, 3) blocks with their values by field."""
        slots = self._memory.add(blocks)
        for name, array in values.items():
            self._memory.arrays[name][slots] = array

    def read(self, blocks: BlockCoordinates) -> tuple[Mapping[str, NDArray[Any]], Slots]:
        """Return arrays of fields that hold (N, 3) blocks, and the (N,) slots of these in them.

        Slots of blocks neither in memory nor on disk are -1.
        """
        slots = self._memory.find(blocks)
        if not len(self._store):
            return self._memory.arrays, slots
        missing = np.flatnonzero(slots < 0)
        stored = missing[self._store.has(blocks[missing])]
        if not len(stored):
            return self._memory.arrays, slots
        used, place = np.unique(slots[slots >= 0], return_inverse=True)
        on_disk, place_on_disk = np.unique(blocks[stored], axis=0, return_inverse=True)
        values = self._store.read(on_disk)
        both = {
            name: np.concatenate((array[used], values[name]))
            for name, array in self._memory.arrays.items()
        }
        joined = np.full(len(slots), -1, np.int32)
        joined[slots >= 0] = place.ravel()
        joined[stored] = len(used) + place_on_disk.ravel()
        return both, joined

    def values(self, blocks: BlockCoordinates) -> dict[str, NDArray[Any]]:
        """Return the values of (N, 3) blocks in memory or on disk, by field."""
        arrays, slots = self.read(blocks)
        return {name: array[slots] for name, array in arrays.items()}

    def _make_room(self, wanted: BlockCoordinates, camera_m: FloatArray) -> BlockCoordinates:
        """Evict blocks until the wanted ones have room; return the evicted ones."""
        is_new = self._memory.find(wanted) < 0
        needed = len(self._memory) + int(is_new.sum())
        if needed <= self._max_blocks:
            return NO_BLOCKS
        check_capacity(needed if self._when_full == "refuse" else len(wanted), self._max_blocks)
        blocks, slots = self._memory.all()
        others = blocks[~np.isin(slots, self._memory.find(wanted)[~is_new])]
        others = others[block_order(others)]
        least = needed - self._max_blocks
        count = min(len(others), max(least, int(EVICTED_SHARE * self._max_blocks)))
        centers_m = (others + 0.5) * (BLOCK_VOXELS * self.voxel_size_m)
        distance_m = np.linalg.norm(centers_m - camera_m, axis=1)
        evicted: BlockCoordinates = others[np.argsort(-distance_m, kind="stable")[:count]]
        self.evict(evicted, store=self._when_full == "store")
        return evicted

    def _with_traversed(
        self, blocks: BlockCoordinates, slots: Slots, rays: DepthPyramid
    ) -> tuple[BlockCoordinates, Slots]:
        """Add the blocks in memory that rays pass through."""
        all_blocks, all_slots = self._memory.all()
        is_other = np.ones(len(self._memory.arrays["weight"]), bool)
        is_other[slots] = False
        others = np.flatnonzero(is_other[all_slots])
        others = others[rays.touches(all_blocks[others])]
        return (
            np.concatenate((blocks, all_blocks[others])),
            np.concatenate((slots, all_slots[others])),
        )
