"""Blocks that the camera has left, in a temporary file that nobody else sees."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_mapping.voxels.blocks import (
    VOXELS,
    Coordinates,
    VoxelField,
    block_bytes,
    packed,
    unpacked,
)


class BlockStore:
    """Blocks on disk, one record each; places of blocks that were taken back are used again.

    The file has no name, so nothing of it is left when the process ends, however it ends.

    Args:
        fields: Of a voxel.
        folder: Where the file lives; None: where the system keeps temporary ones.
    """

    def __init__(self, fields: tuple[VoxelField, ...], folder: Path | None) -> None:
        self._fields = fields
        self._record_bytes = block_bytes(fields)
        self._folder = folder
        self._file: Any = None
        self._places: dict[int, int] = {}
        self._free: list[int] = []

    def __len__(self) -> int:
        """Return how many blocks there are."""
        return len(self._places)

    @property
    def coordinates(self) -> Coordinates:
        """The (N, 3) blocks that are here."""
        return unpacked(np.fromiter(self._places, np.int64, len(self._places)))

    def has(self, coordinates: Coordinates) -> NDArray[np.bool_]:
        """Return (N,) which of (N, 3) blocks are here."""
        return np.fromiter((n in self._places for n in packed(coordinates).tolist()), bool)

    def put(self, coordinates: Coordinates, rows: Mapping[str, NDArray[Any]]) -> None:
        """Write (N, 3) blocks' values, (N, `VOXELS`[, channels]) by field.

        Raises:
            OSError: The disk is full, or cannot be written; what was here is still here.
        """
        records = np.concatenate([_as_bytes(rows[field.name]) for field in self._fields], axis=1)
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 - lives as long
        for number, record in zip(packed(coordinates).tolist(), records, strict=True):
            place = self._places.get(number)
            if place is None:
                place = self._free[-1] if self._free else len(self._places)
            _write(self._file.fileno(), record, place * self._record_bytes)
            if number not in self._places:
                if self._free:
                    self._free.pop()
                self._places[number] = place

    def read(self, coordinates: Coordinates) -> dict[str, NDArray[Any]]:
        """Return the values of (N, 3) blocks that are here, by field; inverse: `put`."""
        records = np.empty((len(coordinates), self._record_bytes), np.uint8)
        for number, record in zip(packed(coordinates).tolist(), records, strict=True):
            offset = self._places[number] * self._record_bytes
            found = os.pread(self._file.fileno(), self._record_bytes, offset)
            record[:] = np.frombuffer(found, np.uint8)
        return self._rows(records)

    def take(self, coordinates: Coordinates) -> dict[str, NDArray[Any]]:
        """Return as `read` does, and forget the blocks."""
        rows = self.read(coordinates)
        self._free += [self._places.pop(number) for number in packed(coordinates).tolist()]
        return rows

    def clear(self) -> None:
        """Forget all blocks and give the disk back."""
        self._places.clear()
        self._free.clear()
        if self._file is not None:
            self._file.close()
            self._file = None

    def _rows(self, records: NDArray[np.uint8]) -> dict[str, NDArray[Any]]:
        rows, first = {}, 0
        for field in self._fields:
            part = np.ascontiguousarray(records[:, first : first + field.block_bytes])
            shape = (VOXELS,) if field.channels == 1 else (VOXELS, field.channels)
            rows[field.name] = part.view(field.dtype).reshape(len(records), *shape)
            first += field.block_bytes
        return rows


def _as_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(values).reshape(len(values), -1).view(np.uint8)


def _write(file: int, record: NDArray[np.uint8], offset: int) -> None:
    left = memoryview(record.tobytes())
    while left:
        written = os.pwrite(file, left, offset)
        left, offset = left[written:], offset + written
