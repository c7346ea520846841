"""What the headers of EXR files say, and which of them may be decoded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import ImageUse

_EXR_CHANNELS = 8
"""Channels of an EXR file with as many pixels as it may have."""

_EXR_CHROMA = ("RY", "BY")
"""Channels that make the luminance in Y a colour."""


def check_exr(file: Any, use: ImageUse, name: str) -> None:
    """Raise unless an EXR file, of which only the headers were read, may be decoded.

    Args:
        file: ``OpenEXR.File`` with headers.
        use: Bounds its size.
        name: Of the file in errors.

    Raises:
        InvalidInputError: It is too large, has deep pixels or channels of chroma, or lacks pixels
            that it shows.
    """
    import OpenEXR

    plain = (OpenEXR.scanlineimage, OpenEXR.tiledimage)
    values = 0
    for part in file.parts:
        header = part.header
        if header.get("type", OpenEXR.scanlineimage) not in plain:
            raise InvalidInputError(use.field, name, f"{use.name} without deep pixels")
        width, height = data_window_size(header)
        use.check(max(width, 0), max(height, 0), name)
        display_window(header, use, name)
        _check_exr_channels(header["channels"], use, name)
        values += width * height * len(header["channels"])
        if "tiles" in header:
            tile = header["tiles"]
            use.check(int(tile.xSize), int(tile.ySize), name)
    if values > use.most_px * _EXR_CHANNELS:
        expected = f"{use.name} of at most {use.most_px * _EXR_CHANNELS} values, not {values}"
        raise InvalidInputError(use.field, name, expected)


def data_window_size(header: Mapping[str, Any]) -> tuple[int, int]:
    """Return the width and height of the pixels that an EXR part holds, its data window."""
    low, high = (np.asarray(corner, np.int64) for corner in header["dataWindow"])
    width, height = (int(each) for each in high - low + 1)
    return width, height


def display_window(header: Mapping[str, Any], use: ImageUse, name: str) -> tuple[slice, slice]:
    """Return rows and columns of an EXR part's pixels that are in its image, the display window.

    Raises:
        InvalidInputError: The image has pixels that are not in the file.
    """
    stored, shown = (
        [[int(each) for each in corner] for corner in header[window]]
        for window in ("dataWindow", "displayWindow")
    )
    (left, top), (right, bottom) = stored
    (first, upper), (last, lower) = shown
    if not (left <= first <= last <= right and top <= upper <= lower <= bottom):
        expected = (
            f"{use.name} with all pixels of its display window {shown}, not only those of its data"
            f" window {stored} (save it uncropped)"
        )
        raise InvalidInputError(use.field, name, expected)
    return slice(upper - top, lower - top + 1), slice(first - left, last - left + 1)


def _check_exr_channels(channels: Sequence[Any], use: ImageUse, name: str) -> None:
    """Raise if an EXR file has luminance and chroma for colours, or channels of another size."""
    chroma = [each.name for each in channels if each.name.rpartition(".")[2] in _EXR_CHROMA]
    if chroma:
        expected = f"{use.name} with channels R, G and B, not luminance and {', '.join(chroma)}"
        raise InvalidInputError(use.field, name, expected)
    coarse = [each.name for each in channels if (each.xSampling, each.ySampling) != (1, 1)]
    if coarse:
        expected = f"{use.name} whose channels have each pixel, not as {', '.join(coarse)}"
        raise InvalidInputError(use.field, name, expected)
