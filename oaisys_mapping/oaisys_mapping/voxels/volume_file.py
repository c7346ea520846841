"""A volume in one ``.npz`` file. Equal volumes have equal bytes.

Arrays of a file, blocks by x, then y, then z; voxels by z, y, x:

* ``format``: `FORMAT`; ``voxel_size_m``: float64; ``frames``: int64, how many views were fused.
* ``blocks``: (N, 3) int32; block (i, j, k) begins at voxel ``8 * (i, j, k)``, and a voxel's sample
  lies at its number times ``voxel_size_m``.
* ``tsdf``: (N, 8, 8, 8) float32 from -1 to 1, in truncations; ``weight``: (N, 8, 8, 8) float32, 0
  where nothing was seen; ``color``: (N, 8, 8, 8, 4) float32 red, green and blue from 0 to 1, and
  the weight that they were told with.
* with semantics: ``class_id``: (N, 8, 8, 8, 4) uint16, ``class_weight``: (N, 8, 8, 8, 4) float32;
  ``cell_blocks``: (M, 3) int32 blocks of cells half a voxel wide, ``cell_class_id``:
  (M, 8, 8, 8, 2) uint16, ``cell_class_weight``: (M, 8, 8, 8, 2) float32. A file without cells is
  one whose cells were told nothing.
* ``truncation_m``: float64; ``free``: (M, 3) int32, blocks that are known to be free.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.voxels.blocks import BLOCK_VOXELS, VOXELS, Coordinates, VoxelField

FORMAT = "oaisys tsdf 1"

VOXEL_BLOCKS, CELL_BLOCKS = "blocks", "cell_blocks"

PART_BLOCKS = 1024
"""Blocks that are written at a time."""

_CUBE = (BLOCK_VOXELS,) * 3


@dataclass(frozen=True)
class VolumeHeader:
    """What a file says about all of a volume."""

    voxel_size_m: float
    truncation_m: float
    frames: int
    free: Coordinates


@dataclass(frozen=True)
class StoredGrid:
    """One of a volume's grids: where its blocks are, and what is in them.

    Attributes:
        name: Of the array of blocks.
        fields: Of a voxel.
        blocks: (N, 3) in order.
        rows: Gives some of the blocks' values by field.
    """

    name: str
    fields: tuple[VoxelField, ...]
    blocks: Coordinates
    rows: Callable[[Coordinates], Mapping[str, NDArray[Any]]]


def write_volume(path: Path, header: VolumeHeader, grids: Sequence[StoredGrid]) -> None:
    """Write a volume whole or not at all; `VOXEL_BLOCKS` come first."""
    beside = path.with_name(path.name + ".part")
    single: dict[str, Any] = {
        "format": np.array(FORMAT),
        "voxel_size_m": np.array(header.voxel_size_m),
        "truncation_m": np.array(header.truncation_m),
        "frames": np.array(header.frames, np.int64),
        "free": header.free,
    }
    try:
        with zipfile.ZipFile(beside, "w") as archive:
            for name, array in single.items():
                _write_array(archive, name, array.shape, array.dtype, [array])
            for grid in grids:
                _write_grid(archive, grid)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def read_volume(
    path: Path, fields: Mapping[str, tuple[VoxelField, ...]]
) -> tuple[VolumeHeader, dict[str, tuple[Coordinates, dict[str, NDArray[Any]]]]]:
    """Return what a file says, and each grid's blocks and values by field; inverse: `write_volume`.

    Args:
        path: The file.
        fields: Of each grid, by its name. One that is not `VOXEL_BLOCKS` may be missing.

    Raises:
        InvalidInputError: The file is no volume, or has not got these fields.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            if str(arrays["format"]) != FORMAT:
                raise ValueError(f"its format is {arrays['format']}")
            header = VolumeHeader(
                float(arrays["voxel_size_m"]),
                float(arrays["truncation_m"]),
                int(arrays["frames"]),
                arrays["free"],
            )
            grids = {
                name: _read_grid(arrays, name, each)
                for name, each in fields.items()
                if name == VOXEL_BLOCKS or name in arrays
            }
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidInputError("path", str(path), f"a saved volume ({error})") from error
    return header, grids


def _read_grid(
    arrays: Any, name: str, fields: tuple[VoxelField, ...]
) -> tuple[Coordinates, dict[str, NDArray[Any]]]:
    blocks = arrays[name]
    return blocks, {field.name: _rows(arrays, field, len(blocks)) for field in fields}


def _rows(arrays: Any, field: VoxelField, blocks: int) -> NDArray[Any]:
    array = arrays[field.name]
    expected = (blocks, *_CUBE, *_channels(field))
    if array.shape != expected or array.dtype != field.dtype:
        raise ValueError(f"{field.name} is {array.dtype} {array.shape}, expected {expected}")
    return np.asarray(array.reshape(blocks, VOXELS, *_channels(field)))


def _channels(field: VoxelField) -> tuple[int, ...]:
    return () if field.channels == 1 else (field.channels,)


def _write_grid(archive: zipfile.ZipFile, grid: StoredGrid) -> None:
    blocks = grid.blocks
    parts = [blocks[i : i + PART_BLOCKS] for i in range(0, len(blocks), PART_BLOCKS)]
    _write_array(archive, grid.name, blocks.shape, blocks.dtype, [blocks])
    for field in grid.fields:
        shape = (len(blocks), *_CUBE, *_channels(field))
        found = (grid.rows(part)[field.name] for part in parts)
        _write_array(archive, field.name, shape, np.dtype(field.dtype), found)


def _write_array(
    archive: zipfile.ZipFile,
    name: str,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    parts: Iterable[NDArray[Any]],
) -> None:
    """Write an array as ``numpy.savez`` does, part by part and without the time of day."""
    entry = zipfile.ZipInfo(f"{name}.npy")
    described = {
        "descr": dtype.str,
        "fortran_order": False,
        "shape": shape,
    }
    with archive.open(entry, "w", force_zip64=True) as file:
        np.lib.format.write_array_header_1_0(file, described)  # type: ignore[no-untyped-call]
        for part in parts:
            file.write(np.ascontiguousarray(part).tobytes())
