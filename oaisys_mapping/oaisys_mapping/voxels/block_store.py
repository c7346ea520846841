"""Blocks on disk, in an unnamed temporary file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_mapping.voxels.block_layout import (
    BlockCoordinates,
    VoxelField,
    block_keys,
    blocks_of_keys,
)


class BlockStore:
    """Blocks on disk, one record each; records of removed blocks are reused.

    The file has no name, so nothing is left of it however the process ends. It is written with
    system calls: a full disk is an error there, where a memory-mapped file would kill the process.

    Args:
        fields: Values stored for each voxel.
        folder: Folder of the file; None: the system's temporary folder.
    """

    def __init__(self, fields: tuple[VoxelField, ...], folder: Path | None) -> None:
        self._record = np.dtype([(field.name, field.dtype, field.shape) for field in fields])
        self._folder = folder
        self._file: Any = None
        self._places: dict[int, int] = {}
        self._unused: list[int] = []

    def __len__(self) -> int:
        """Return how many blocks there are."""
        return len(self._places)

    @property
    def blocks(self) -> BlockCoordinates:
        """The (N, 3) stored blocks."""
        return blocks_of_keys(np.fromiter(self._places, np.int64, len(self._places)))

    def has(self, blocks: BlockCoordinates) -> NDArray[np.bool_]:
        """Return (N,) which of (N, 3) blocks are stored."""
        return np.fromiter((key in self._places for key in block_keys(blocks).tolist()), bool)

    def put(self, blocks: BlockCoordinates, values: Mapping[str, NDArray[Any]]) -> None:
        """Write (N, 3) blocks' values, (N, `VOXELS`[, channels]) by field.

        Raises:
            OSError: The disk is full or cannot be written; stored blocks are unchanged.
        """
        records = np.empty(len(blocks), self._record)
        for name, array in values.items():
            records[name] = array
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 - lives as long
        for key, record in zip(block_keys(blocks).tolist(), records, strict=True):
            place = self._places.get(key)
            if place is None:
                place = self._unused[-1] if self._unused else len(self._places)
            _write(self._file.fileno(), record.tobytes(), place * self._record.itemsize)
            if key not in self._places:
                if self._unused:
                    self._unused.pop()
                self._places[key] = place

    def read(self, blocks: BlockCoordinates) -> dict[str, NDArray[Any]]:
        """Return the values of (N, 3) stored blocks by field; inverse: `put`."""
        size = self._record.itemsize
        places = [self._places[key] for key in block_keys(blocks).tolist()]
        content = b"".join(os.pread(self._file.fileno(), size, place * size) for place in places)
        records = np.frombuffer(content, self._record)
        return {name: records[name] for name in self._record.names or ()}

    def take(self, blocks: BlockCoordinates) -> dict[str, NDArray[Any]]:
        """Return what `read` does, and remove the blocks."""
        values = self.read(blocks)
        self._unused += [self._places.pop(key) for key in block_keys(blocks).tolist()]
        return values


def _write(file: int, content: bytes, offset: int) -> None:
    left = memoryview(content)
    while left:
        written = os.pwrite(file, left, offset)
        left, offset = left[written:], offset + written
