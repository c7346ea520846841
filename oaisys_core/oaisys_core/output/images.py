"""Writing and reading frames as lossless image files.

| pixels | file |
|---|---|
| 8 bits, one or three channels | PNG |
| 16 bits (``semantic_N``) | PNG |
| 32-bit ids (``instance``) | 16-bit PNG, or 32-bit TIFF if an id is above 65535 |
| 32-bit floats, one channel | EXR, channel Y |
| 32-bit floats, two or three channels | EXR, channels R, G and B for x, y and z |
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.io import MemoryFile

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.output.exr import GREY, read_channels, write_channels
from oaisys_core.output.files import whole, write_bytes
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    RANGE,
    Frame,
    modality_spec,
    semantic_level,
)

MOST_IN_PNG = 65535
NAMES = {DEPTH: "pinhole_depth", RANGE: "euclidean_depth", INSTANCE: "instance_label"}
"""File names that differ from the modality's name, as in the original simulator."""


def file_stem(modality: str) -> str:
    """Return the end of a file name for a modality, without the suffix."""
    level = semantic_level(modality)
    if level is not None:
        return f"semantic_label_{level:02d}"
    return f"{NAMES.get(modality, modality)}_00"


def file_kind(data: NDArray[Any]) -> str:
    """Return the suffix of the file for an array of pixels."""
    if data.dtype.kind == "f":
        return ".exr"
    return ".tif" if data.dtype.itemsize > 2 and data.max(initial=0) > MOST_IN_PNG else ".png"


def file_suffix(frame: Frame) -> str:
    """Return the end of a frame's file name, with the suffix."""
    return file_stem(frame.modality) + file_kind(frame.data)


def write_image(path: Path, frame: Frame) -> None:
    """Write a frame's pixels; inverse: `read_image`.

    Raises:
        RenderError: It could not be written; there is no partial file.
    """
    data = frame.data
    kind = file_kind(data)
    if path.suffix != kind:
        raise RenderError(f"{path.name}: these pixels need a file that ends in {kind}")
    if kind == ".exr":
        names = GREY if data.ndim == 2 else "RGB"[: data.shape[-1]]
        planes = data[..., None] if data.ndim == 2 else data
        with whole(path) as part:
            write_channels(part, dict(zip(names, np.moveaxis(planes, -1, 0), strict=True)))
    elif kind == ".tif":
        _write_tiff(path, data)
    else:
        data = data.astype(np.uint16) if data.dtype.itemsize > 2 else data
        colors_first = data[..., ::-1] if data.ndim == 3 else data
        _, png = cv2.imencode(".png", np.ascontiguousarray(colors_first))
        write_bytes(path, png.tobytes())


def read_image(path: Path, modality: str) -> NDArray[Any]:
    """Return the pixels of a file as `modality_spec` describes them.

    Raises:
        InvalidInputError: It cannot be read, or is not an image of that modality.
    """
    spec = modality_spec(modality)
    if path.suffix == ".exr":
        channels = read_channels(path)
        names = GREY if spec.channels == 1 else "RGB"[: spec.channels]
        if set(channels) != set(names):
            expected = f"an image with the channels {', '.join(names)}"
            raise InvalidInputError("image", str(path), expected)
        planes = [channels[name] for name in names]
        data = planes[0] if spec.channels == 1 else np.stack(planes, axis=-1)
    elif path.suffix == ".tif":
        data = _read_tiff(path)
    else:
        found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
        if found is None:
            raise InvalidInputError("image", str(path), "a readable image")
        data = np.asarray(found[..., ::-1] if found.ndim == 3 else found)
    if data.ndim != (2 if spec.channels == 1 else 3):
        raise InvalidInputError("image", str(path), f"{spec.channels} channels ({modality})")
    return np.ascontiguousarray(data.astype(spec.dtype, copy=False))


def _write_tiff(path: Path, data: NDArray[Any]) -> None:
    """Write a TIFF by way of memory, because GDAL reports a full disk on standard error only."""
    shape = {"height": data.shape[0], "width": data.shape[1], "count": 1, "dtype": data.dtype}
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with memory.open(driver="GTiff", compress="deflate", **shape) as file:
            file.write(data, 1)
        write_bytes(path, bytes(memory.getbuffer()))


def _read_tiff(path: Path) -> NDArray[Any]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                return np.asarray(file.read(1))
    except RasterioError as error:
        raise InvalidInputError("image", str(path), f"a readable image ({error})") from error
