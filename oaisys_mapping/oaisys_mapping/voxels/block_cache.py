"""Which blocks are in memory, which on disk, and which have to go when there is no more room."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError
from oaisys_core.types import FloatArray
from oaisys_mapping.voxels.block_store import BlockStore
from oaisys_mapping.voxels.blocks import (
    BLOCK_VOXELS,
    INITIAL_BLOCKS,
    Coordinates,
    Slots,
    VoxelBlocks,
    VoxelField,
    block_order,
    packed,
    unpacked,
)
from oaisys_mapping.voxels.padded_images import FreeSpace

ROOM_SHARE = 0.1
"""Share of the blocks that goes at a time where there is no more room."""

_NONE = np.zeros((0, 3), np.int32)


class VolumeFullError(OaisysError):
    """A view needs more memory than a volume may use."""


def check_room(needed: int, most_blocks: int) -> None:
    """Refuse more blocks than there may be."""
    if needed > most_blocks:
        raise VolumeFullError(
            f"the map would need {needed} blocks of {BLOCK_VOXELS} voxels, and {most_blocks} may "
            "be used: choose larger voxels or a shorter range"
        )


@dataclass(frozen=True)
class ViewBlocks:
    """Blocks made ready for a view.

    Attributes:
        blocks, slots: (N, 3) and (N,) blocks that the view may say something about.
        restored: (M, 3) that came back from disk.
        gone: (K, 3) that are no longer in memory.
    """

    blocks: Coordinates
    slots: Slots
    restored: Coordinates
    gone: Coordinates


class BlockCache:
    """Blocks in memory, as many as allowed, and the store behind them.

    Args:
        voxel_size_m: Edge length of a voxel.
        fields: Of a voxel.
        most_blocks: That may be in memory.
        when_full: What becomes of those farthest from the camera: one of `WHEN_FULL`.
        store_folder: Where stored blocks go; None: where temporary files do.
        initial_blocks: That memory is reserved for at first.
    """

    def __init__(
        self,
        voxel_size_m: float,
        fields: tuple[VoxelField, ...],
        *,
        most_blocks: int,
        when_full: str,
        store_folder: Path | None,
        initial_blocks: int = INITIAL_BLOCKS,
    ) -> None:
        self._block_m = BLOCK_VOXELS * voxel_size_m
        self._most_blocks = most_blocks
        self._when_full = when_full
        self._blocks = VoxelBlocks(voxel_size_m, fields, most_blocks, initial_blocks)
        self._store = BlockStore(fields, store_folder)
        self.near_surface = self._blocks.near_surface

    @property
    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """Fields of the voxels in memory by slot."""
        return self._blocks.arrays

    @property
    def in_memory(self) -> int:
        """How many blocks are in memory."""
        return len(self._blocks)

    @property
    def stored(self) -> int:
        """How many blocks are on disk."""
        return len(self._store)

    @property
    def blocks_in_memory(self) -> Coordinates:
        """The (N, 3) blocks in memory, in any order."""
        return self._blocks.all()[0]

    @property
    def stored_blocks(self) -> Coordinates:
        """The (N, 3) blocks on disk."""
        return self._store.coordinates

    @property
    def all_blocks(self) -> Coordinates:
        """The (N, 3) blocks in memory and on disk, in `block_order`."""
        both = np.concatenate((self._blocks.all()[0], self._store.coordinates))
        return both[block_order(both)]

    def make_ready(
        self, near: Coordinates, clears: FreeSpace | None, camera_m: FloatArray
    ) -> ViewBlocks:
        """Bring blocks into memory that a view shows a surface in or passes through.

        Args:
            near: (N, 3) those with a surface; they are made where they are missing.
            clears: Tells what rays pass through; None: nothing.
            camera_m: (3,) where the camera is.

        Raises:
            VolumeFullError: There is no room; nothing has changed.
        """
        wanted = near
        if len(self._store) and clears is not None:
            away = self._store.coordinates
            wanted = _merged(near, away[clears.touched(away)])
        is_stored = self._store.has(wanted) if len(self._store) else np.zeros(len(wanted), bool)
        gone = self._make_room(wanted, camera_m)
        slots = self._blocks.add(wanted)
        restored = wanted[is_stored]
        if len(restored):
            for name, rows in self._store.take(restored).items():
                self._blocks.arrays[name][slots[is_stored]] = rows
        if clears is not None:
            wanted, slots = self._with_passed(wanted, slots, clears)
        return ViewBlocks(wanted, slots, restored, gone)

    def add(self, coordinates: Coordinates) -> Slots:
        """Return the (N,) slots of (N, 3) blocks; of those that are missing, as many as have room.

        Where there is no more, the last ones are left out: -1.
        """
        missing = np.flatnonzero(self._blocks.find(coordinates) < 0)
        no_room = missing[max(0, self._most_blocks - len(self._blocks)) :]
        self._blocks.add(np.delete(coordinates, no_room, axis=0))
        return self._blocks.find(coordinates)

    def put_away(self, coordinates: Coordinates, *, stores: bool) -> None:
        """Take (N, 3) blocks out of memory, to disk or for good; others than are there are not.

        Raises:
            VolumeFullError: The disk is full; they are still in memory.
        """
        gone = coordinates[self._blocks.find(coordinates) >= 0]
        if stores and len(gone):
            try:
                self._store.put(gone, self.rows(gone))
            except OSError as error:
                raise VolumeFullError(f"blocks cannot be stored: {error}") from error
        self._blocks.remove(gone)

    def bring_back(self, coordinates: Coordinates) -> None:
        """Take those of (N, 3) blocks that are on disk into memory."""
        stored = coordinates[self._store.has(coordinates)]
        if len(stored):
            self.fill(stored, self._store.take(stored))

    def fill(self, coordinates: Coordinates, rows: Mapping[str, NDArray[Any]]) -> None:
        """Take in (N, 3) blocks with their values."""
        slots = self._blocks.add(coordinates)
        for name, values in rows.items():
            self._blocks.arrays[name][slots] = values

    def values(self, coordinates: Coordinates) -> tuple[Mapping[str, NDArray[Any]], Slots]:
        """Return fields of voxels and the (N,) slots of blocks in them, -1 where there is none."""
        slots = self._blocks.find(coordinates)
        if not len(self._store):
            return self._blocks.arrays, slots
        missing = np.flatnonzero(slots < 0)
        stored = missing[self._store.has(coordinates[missing])]
        if not len(stored):
            return self._blocks.arrays, slots
        used, place = np.unique(slots[slots >= 0], return_inverse=True)
        away, place_away = np.unique(coordinates[stored], axis=0, return_inverse=True)
        rows = self._store.read(away)
        both = {
            name: np.concatenate((array[used], rows[name]))
            for name, array in self._blocks.arrays.items()
        }
        joined = np.full(len(slots), -1, np.int32)
        joined[slots >= 0] = place.ravel()
        joined[stored] = len(used) + place_away.ravel()
        return both, joined

    def rows(self, coordinates: Coordinates) -> dict[str, NDArray[Any]]:
        """Return the values of (N, 3) blocks in memory or on disk, by field."""
        arrays, slots = self.values(coordinates)
        return {name: array[slots] for name, array in arrays.items()}

    def _make_room(self, wanted: Coordinates, camera_m: FloatArray) -> Coordinates:
        """Let blocks go until the wanted ones have room; return which did."""
        is_new = self._blocks.find(wanted) < 0
        needed = len(self._blocks) + int(is_new.sum())
        if needed <= self._most_blocks:
            return _NONE
        check_room(needed if self._when_full == "refuse" else len(wanted), self._most_blocks)
        coordinates, slots = self._blocks.all()
        others = coordinates[~np.isin(slots, self._blocks.find(wanted)[~is_new])]
        others = others[block_order(others)]
        least = needed - self._most_blocks
        count = min(len(others), max(least, int(ROOM_SHARE * self._most_blocks)))
        away_m = np.linalg.norm((others + 0.5) * self._block_m - camera_m, axis=1)
        gone: Coordinates = others[np.argsort(-away_m, kind="stable")[:count]]
        self.put_away(gone, stores=self._when_full == "store")
        return gone

    def _with_passed(
        self, blocks: Coordinates, slots: Slots, clears: FreeSpace
    ) -> tuple[Coordinates, Slots]:
        """Add the blocks in memory that rays pass through."""
        all_blocks, all_slots = self._blocks.all()
        is_other = np.ones(len(self._blocks.arrays["weight"]), bool)
        is_other[slots] = False
        others = np.flatnonzero(is_other[all_slots])
        others = others[clears.touched(all_blocks[others])]
        return (
            np.concatenate((blocks, all_blocks[others])),
            np.concatenate((slots, all_slots[others])),
        )


def _merged(blocks: Coordinates, more: Coordinates) -> Coordinates:
    """Return all blocks of both, once each."""
    if not len(more):
        return blocks
    return unpacked(np.union1d(packed(blocks), packed(more)))
