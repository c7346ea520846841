"""A volume as one ``.npz`` file; equal volumes have equal bytes.

Arrays in the file, with blocks sorted by x, then y, then z, and voxels by z, y, x:

* ``format``: `FORMAT`; ``voxel_size_m``: float64; ``frames``: int64, number of integrated views.
* ``blocks``: (N, 3) int32; block (i, j, k) begins at voxel ``8 * (i, j, k)``, and a voxel's sample
  lies at its number times ``voxel_size_m``.
* ``tsdf``: (N, 8, 8, 8) float32 from -1 to 1, in truncations; ``weight``: (N, 8, 8, 8) float32, 0
  where nothing was observed; ``color``: (N, 8, 8, 8, 4) float32 red, green and blue from 0 to 1,
  and their weight.
* with semantics: ``class_id``: (N, 8, 8, 8, 4) uint16, ``class_weight``: (N, 8, 8, 8, 4) float32;
  ``cell_blocks``: (M, 3) int32 blocks of cells half a voxel wide, ``cell_class_id``:
  (M, 8, 8, 8, 2) uint16, ``cell_class_weight``: (M, 8, 8, 8, 2) float32. A file may lack the
  cells; they are empty then.
* ``truncation_m``: float64; ``free``: (M, 3) int32, blocks that are known to be free.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.arrays import load_arrays
from oaisys_core.files.whole_files import whole_file
from oaisys_mapping.voxels.block_cache import BlockCache
from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    MAX_COORDINATE,
    VOXELS,
    BlockCoordinates,
    VoxelField,
)
from oaisys_mapping.voxels.config import TsdfConfig

FORMAT = "oaisys tsdf 1"

VOXEL_BLOCKS, CELL_BLOCKS = "blocks", "cell_blocks"

BATCH_BLOCKS = 1024
"""Blocks that are written at a time."""

_CUBE = (BLOCK_VOXELS,) * 3


@dataclass(frozen=True)
class VolumeHeader:
    """What a file says about the whole volume.

    Attributes:
        frames: Number of integrated views.
        free: (M, 3) blocks that are known to be free.
    """

    voxel_size_m: float
    truncation_m: float
    frames: int
    free: BlockCoordinates

    def check_matches(self, config: TsdfConfig, path: Path) -> None:
        """Raise InvalidInputError where voxel size or truncation differ from a configuration's."""
        for name in ("voxel_size_m", "truncation_m"):
            found, expected = getattr(self, name), getattr(config, name)
            if not np.isclose(found, expected):
                raise InvalidInputError("path", f"{path}: {name} {found:g}", f"{expected:g} m")


def write_volume(path: Path, header: VolumeHeader, grids: Mapping[str, BlockCache]) -> None:
    """Write a volume's grids by name, completely or not at all."""
    header_arrays: dict[str, Any] = {
        "format": np.array(FORMAT),
        "voxel_size_m": np.array(header.voxel_size_m),
        "truncation_m": np.array(header.truncation_m),
        "frames": np.array(header.frames, np.int64),
        "free": header.free,
    }
    with whole_file(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name, array in header_arrays.items():
            _write_array(archive, name, array.shape, array.dtype, [array])
        for name, grid in grids.items():
            _write_grid(archive, name, grid)


MAX_VOLUME_BYTES = 16_000_000_000
"""Size of the arrays in a file."""


def read_volume(
    path: Path, fields: Mapping[str, tuple[VoxelField, ...]]
) -> tuple[VolumeHeader, dict[str, tuple[BlockCoordinates, dict[str, NDArray[Any]]]]]:
    """Return a file's header, and each grid's blocks and values; inverse: `write_volume`.

    Args:
        path: The file.
        fields: Fields of each grid by its name. Grids except `VOXEL_BLOCKS` may be missing.

    Raises:
        InvalidInputError: The file is not a volume, or lacks these fields.
    """
    try:
        arrays = load_arrays(path, MAX_VOLUME_BYTES)
        if str(arrays["format"]) != FORMAT:
            raise ValueError(f"its format is {arrays['format']}")
        header = _read_header(arrays)
        grids = {
            name: _read_grid(arrays, name, each)
            for name, each in fields.items()
            if name == VOXEL_BLOCKS or name in arrays
        }
    except KeyError as error:
        raise InvalidInputError("path", str(path), f"a saved volume with {error}") from error
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidInputError("path", str(path), f"a saved volume ({error})") from error
    return header, grids


def _read_header(arrays: Any) -> VolumeHeader:
    header = VolumeHeader(
        float(arrays["voxel_size_m"]),
        float(arrays["truncation_m"]),
        int(arrays["frames"]),
        _read_blocks(arrays, "free"),
    )
    for name in ("voxel_size_m", "truncation_m"):
        if not 0 < getattr(header, name) < math.inf:
            raise ValueError(f"{name} is {getattr(header, name):g}, expected a number above 0")
    if header.frames < 0:
        raise ValueError(f"frames is {header.frames}, expected 0 or more")
    return header


def _read_blocks(arrays: Any, name: str) -> BlockCoordinates:
    """Return (N, 3) blocks, each of which must be one of a map, and there once."""
    blocks = arrays[name]
    if blocks.dtype != np.int32 or blocks.ndim != 2 or blocks.shape[1] != 3:
        raise ValueError(f"{name} is {blocks.dtype} {blocks.shape}, expected int32 (N, 3)")
    # Blocks of cells are half as large.
    far = np.abs(blocks.astype(np.int64)).max(axis=1, initial=0) >= 2 * MAX_COORDINATE
    if far.any():
        found = blocks[far][0].tolist()
        raise ValueError(f"{name} has {found}, expected less than {2 * MAX_COORDINATE}")
    numbers = (blocks + 2 * MAX_COORDINATE).astype(np.int64) @ (1 << np.array((36, 18, 0)))
    if len(np.unique(numbers)) < len(blocks):
        raise ValueError(f"{name} has a block twice")
    return np.asarray(blocks)


def _read_grid(
    arrays: Any, name: str, fields: tuple[VoxelField, ...]
) -> tuple[BlockCoordinates, dict[str, NDArray[Any]]]:
    blocks = _read_blocks(arrays, name)
    return blocks, {field.name: _field_values(arrays, field, len(blocks)) for field in fields}


def _field_values(arrays: Any, field: VoxelField, blocks: int) -> NDArray[Any]:
    array = arrays[field.name]
    expected = (blocks, *_CUBE, *_channels(field))
    if array.shape != expected or array.dtype != field.dtype:
        raise ValueError(f"{field.name} is {array.dtype} {array.shape}, expected {expected}")
    # A sum takes no memory, and of float64 it is finite where all values are.
    if not np.isfinite(array.sum(dtype=np.float64)):
        raise ValueError(f"{field.name} has values that are not finite")
    return np.asarray(array.reshape(blocks, VOXELS, *_channels(field)))


def _channels(field: VoxelField) -> tuple[int, ...]:
    return () if field.channels == 1 else (field.channels,)


def _write_grid(archive: zipfile.ZipFile, name: str, grid: BlockCache) -> None:
    blocks = grid.all_blocks
    parts = [blocks[i : i + BATCH_BLOCKS] for i in range(0, len(blocks), BATCH_BLOCKS)]
    _write_array(archive, name, blocks.shape, blocks.dtype, [blocks])
    for field in grid.fields:
        shape = (len(blocks), *_CUBE, *_channels(field))
        found = (grid.values(part)[field.name] for part in parts)
        _write_array(archive, field.name, shape, np.dtype(field.dtype), found)


def _write_array(
    archive: zipfile.ZipFile,
    name: str,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    parts: Iterable[NDArray[Any]],
) -> None:
    """Write an array as ``numpy.savez`` does, but in parts and without a time stamp."""
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
