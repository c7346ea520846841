"""OpenEXR images with 32-bit floats."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, RenderError, quote
from oaisys_core.files.image_formats.exr_headers import check_exr, display_window
from oaisys_core.files.image_formats.image_use import FRAME, ImageUse
from oaisys_core.files.image_formats.images import read_file
from oaisys_core.output.files import write_bytes

GREY = "Y"
"""Name of the channel of a single-channel image."""


def write_channels(path: Path, channels: Mapping[str, NDArray[Any]]) -> None:
    """Write (H, W) float32 channels by name without loss; inverse: `read_channels`.

    Raises:
        RenderError: They could not be written.
    """
    write_bytes(path, encode_channels(channels))


def encode_channels(channels: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the EXR file of (H, W) float32 channels by name; inverse: `decode_channels`.

    Raises:
        RenderError: They cannot be encoded.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {name: np.ascontiguousarray(c, np.float32) for name, c in channels.items()}
    stream = io.BytesIO()
    try:
        with OpenEXR.File(header, planes) as file:
            file.write(stream)
    except (OSError, RuntimeError) as error:
        raise RenderError(f"an EXR image could not be encoded: {error}") from error
    return stream.getvalue()


def read_channels(
    path: Path, use: ImageUse = FRAME, *, all_parts: bool = False
) -> dict[str, NDArray[Any]]:
    """Return the (H, W) channels of an image, by name.

    Args:
        path: The file.
        use: Bounds its size.
        all_parts: Whether it may have several parts, whose channels then have different names, as
            Blender writes them.

    Raises:
        InvalidInputError: It cannot be read, or is larger than ``use`` allows.
    """
    return decode_channels(read_file(path, use), str(path), use, all_parts=all_parts)


def decode_channels(
    data: bytes, name: str, use: ImageUse = FRAME, *, all_parts: bool = False
) -> dict[str, NDArray[Any]]:
    """Return the (H, W) channels of an EXR file's bytes, by name; errors call it ``name``.

    They are those of the display window: what is stored beyond it (overscan) is left out.

    Raises:
        InvalidInputError: They are no EXR image, or one that ``use`` does not allow.
    """
    import OpenEXR

    try:
        with OpenEXR.File(io.BytesIO(data), header_only=True) as file:
            check_exr(file, use, name)
            count = len(file.parts)
            if count > 1 and not all_parts:
                parts = ", ".join(quote(part.header.get("name", "")) for part in file.parts)
                expected = f"{use.name} of one part, not of {count}: {parts}"
                raise InvalidInputError(use.field, name, expected)
        with OpenEXR.File(io.BytesIO(data), separate_channels=True) as file:
            if len(file.parts) != count:  # OpenEXR leaves out those that it cannot decode
                raise ValueError("its pixels are damaged")
            return {
                channel: np.asarray(values.pixels)[display_window(part.header, use, name)]
                for part in file.parts
                for channel, values in part.channels.items()
            }
    except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
        raise use.refusal(name, error) from error
