"""Arrays in NPZ files, whose headers are read and bounded before the arrays are."""

from __future__ import annotations

import math
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import quote
from oaisys_core.files.documents import DocumentError

MAX_ARRAYS = 1000


def load_arrays(path: Path, most_bytes: int) -> dict[str, NDArray[Any]]:
    """Return the arrays in an NPZ file by name; objects of Python are refused.

    Args:
        path: The file.
        most_bytes: Size that all of them may have together.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no such file, or its arrays are larger or more than they may be.
    """
    if path.exists() and not path.is_file():
        raise DocumentError("it is not a regular file")
    try:
        with zipfile.ZipFile(path) as archive:
            _check(archive, most_bytes)
        with np.load(path, allow_pickle=False) as arrays:
            return dict(arrays)
    except DocumentError:
        raise
    except ValueError as error:  # has the header of an array in it
        raise DocumentError(f"it is damaged ({quote(str(error))})") from error
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, SyntaxError) as error:
        raise DocumentError(f"it is damaged ({error})") from error


def _check(archive: zipfile.ZipFile, most_bytes: int) -> None:
    entries = archive.infolist()
    if len(entries) > MAX_ARRAYS:
        raise DocumentError(f"it has {len(entries)} arrays, more than {MAX_ARRAYS}")
    total = sum(_array_bytes(archive, entry) for entry in entries)
    if total > most_bytes:
        raise DocumentError(f"its arrays have {total} bytes, more than {most_bytes}")


def _array_bytes(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> int:
    """Return the size of an array as its header says."""
    if not entry.filename.endswith(".npy"):
        raise DocumentError(f"{os.fsencode(entry.filename)[:80]!r} in it is not an array")
    npy: Any = np.lib.format
    with archive.open(entry) as file:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = read(file)
    if dtype.hasobject:
        raise DocumentError("it contains Python objects")
    if any(length < 0 for length in shape):
        raise DocumentError(f"an array in it has the shape {shape}")
    return int(math.prod(shape) * dtype.itemsize)
