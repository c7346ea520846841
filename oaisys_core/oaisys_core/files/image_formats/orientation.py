"""How images lie: where their first rows and columns belong, by EXIF's and TIFF's numbers."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

_WITH_EXIF = (b"\xff\xd8", b"\x89PNG", b"RIFF")
_EXIF_NAMES = (b"Exif", b"eXIf", b"EXIF")


def exif_orientation(data: bytes) -> int:
    """Return where the first row and column of a JPEG, PNG or WebP file belong, 1 to 8.

    1 is at the top and left, as without EXIF.

    Raises:
        ValueError: EXIF is damaged, or has another number.
    """
    if not (data.startswith(_WITH_EXIF) and any(name in data for name in _EXIF_NAMES)):
        return 1
    from PIL import ExifTags, Image

    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG", "WEBP")) as image:
            found = image.getexif().get(ExifTags.Base.Orientation, 1)
    except (OSError, ValueError, SyntaxError, struct.error) as error:
        raise ValueError(f"its EXIF cannot be read: {error}") from error
    if found not in range(1, 9):
        raise ValueError(f"its EXIF orientation is {found!r}, expected 1 to 8")
    return int(found)


def upright(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Return pixels whose first row is the top one and whose first column is the left one."""
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels
