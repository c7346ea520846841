"""Writing and reading frames as lossless image files.

| pixels | file |
|---|---|
| 8 bits, one or three channels | PNG |
| 16 bits (``semantic_N``) | PNG |
| 32-bit ids (``instance``) | 16-bit PNG, or 32-bit TIFF if an id is above 65535 |
| 32-bit floats, one channel | EXR, channel Y |
| 32-bit floats, two or three channels | EXR, channels R, G and B for x, y and z |

Data sets keep floats as TIFF files that are compressed with Zstandard (`tiff.encode_floats`): a
third of the processor time of EXR files, and half of their size.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.files.image_formats.image_use import FRAME
from oaisys_core.files.image_formats.images import decode_pixels, read_file
from oaisys_core.output import plain_images
from oaisys_core.output.exr import GREY, decode_channels, encode_channels
from oaisys_core.output.files import write_bytes
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    RANGE,
    Frame,
    modality_spec,
    semantic_level,
)

MAX_IN_PNG = 65535

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
    return ".tif" if data.dtype.itemsize > 2 and data.max(initial=0) > MAX_IN_PNG else ".png"


def file_suffix(frame: Frame) -> str:
    """Return the end of a frame's file name, with the suffix."""
    return file_stem(frame.modality) + file_kind(frame.data)


def write_image(path: Path, frame: Frame) -> None:
    """Write a frame's pixels; inverse: `read_image`.

    Raises:
        RenderError: It could not be written; there is no partial file.
    """
    kind = file_kind(frame.data)
    if path.suffix != kind:
        raise RenderError(f"{path.name}: these pixels need a file that ends in {kind}")
    write_bytes(path, encode_image(frame.data))


def encode_image(data: NDArray[Any]) -> bytes:
    """Return the file of an array of pixels, of the kind `file_kind`; inverse: `decode_image`.

    Equal pixels give equal bytes.

    Raises:
        RenderError: It cannot be encoded.
    """
    kind = file_kind(data)
    if kind == ".exr":
        names = GREY if data.ndim == 2 else "RGB"[: data.shape[-1]]
        planes = data[..., None] if data.ndim == 2 else data
        return encode_channels(dict(zip(names, np.moveaxis(planes, -1, 0), strict=True)))
    if kind == ".tif":
        from oaisys_core.output import tiff

        return tiff.encode(data, compress="deflate")
    import cv2

    data = data.astype(np.uint16) if data.dtype.itemsize > 2 else data
    blue_first = cv2.cvtColor(data, cv2.COLOR_RGB2BGR) if data.ndim == 3 else data
    _, png = cv2.imencode(".png", np.ascontiguousarray(blue_first))
    file: bytes = png.tobytes()
    return file


def read_image(path: Path, modality: str) -> NDArray[Any]:
    """Return the pixels of a file as `modality_spec` describes them.

    Raises:
        InvalidInputError: It cannot be read, or is not an image of that modality.
    """
    return decode_image(read_file(path, FRAME), modality, str(path))


def decode_image(file: bytes, modality: str, name: str) -> NDArray[Any]:
    """Return the pixels of a file's bytes as `modality_spec` describes them.

    Args:
        file: The bytes.
        modality: What the image shows.
        name: The file's name: its suffix says the kind, and errors cite it.

    Raises:
        InvalidInputError: It cannot be read, or is not an image of that modality.
    """
    spec = modality_spec(modality)
    kind = name[name.rfind(".") :]
    if kind == ".exr":
        channels = decode_channels(file, name)
        names = GREY if spec.channels == 1 else "RGB"[: spec.channels]
        if set(channels) != set(names):
            expected = f"an image with the channels {', '.join(names)}"
            raise InvalidInputError("image", name, expected)
        planes = [channels[each] for each in names]
        data = planes[0] if spec.channels == 1 else np.stack(planes, axis=-1)
    elif kind == ".tif":
        data = _decode_tiff(file, name)
    else:
        data = _decode_png(file, name)
    if data.shape[2:] != (() if spec.channels == 1 else (spec.channels,)):
        raise InvalidInputError("image", name, f"{spec.channels} channels ({modality})")
    return np.ascontiguousarray(data.astype(spec.dtype, copy=False))


def _decode_tiff(file: bytes, name: str) -> NDArray[Any]:
    try:
        from oaisys_core.output import tiff
    except ImportError:  # an installation that only reads data sets
        return plain_images.decode_tiff(file, name)
    return tiff.decode(file, name)


def _decode_png(file: bytes, name: str) -> NDArray[Any]:
    try:
        found = decode_pixels(file, FRAME, name)
    except ImportError:
        return plain_images.decode_png(file, name)
    return np.asarray(found[..., ::-1] if found.ndim == 3 else found)
