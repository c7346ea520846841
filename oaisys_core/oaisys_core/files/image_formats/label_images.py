"""Reads images whose pixels are ids: grey values, or colours."""

from __future__ import annotations

import logging
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import ImageUse
from oaisys_core.files.image_formats.images import read_pixels

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class LabelPixels:
    """The pixels of a label image.

    Attributes:
        values: (H, W) grey values, or colours as 0xrrggbb.
        is_color: Whether they are colours.
    """

    values: NDArray[np.int64]
    is_color: bool

    def where(self, value: str) -> NDArray[np.bool_]:
        """Return (H, W) where the image has a value, as a mapping names it.

        A grey value is also found as a colour, and a grey ``#rrggbb`` as a grey value.
        """
        number = _number(value, self.is_color)
        if number is None:
            return np.zeros(self.values.shape, bool)
        return np.asarray(self.values == number)

    def check_values(self, values: Collection[str], path: Path, field: str) -> None:
        """Raise if no pixel has any of a mapping's values; warn of grey ones that colours lack.

        Files with a palette are colours, whose numbers some sets of labels mean by their values.

        Raises:
            InvalidInputError: No pixel has one of the values.
        """
        missing = [value for value in values if not self.where(value).any()]
        if len(missing) == len(values):
            expected = f"an image with values of the mapping; it has {self.first_values()}"
            raise InvalidInputError(field, str(path), expected)
        if self.is_color and (grey := [value for value in missing if not value.startswith("#")]):
            _LOG.warning(
                "%s: no pixel has the grey value %s of %s; colours count, of a palette too: %s",
                path, ", ".join(grey), field, self.first_values(),
            )  # fmt: skip

    def first_values(self) -> str:
        """Return the least eight values of the image, as a mapping names them."""
        values = np.unique(self.values)[:8]
        return ", ".join(f"#{value:06x}" if self.is_color else str(value) for value in values)


def read_label_pixels(path: Path, use: ImageUse) -> LabelPixels:
    """Return the pixels of a grey image of 8 or 16 bits, or of a colour image of 8 bits.

    Raises:
        InvalidInputError: It is of another kind, too large, or cannot be read.
    """
    image = read_pixels(path, use)
    if image.dtype.kind != "u":
        raise InvalidInputError(use.field, str(path), f"{use.name} of 8 or 16 bits")
    if image.ndim == 2:
        return LabelPixels(image.astype(np.int64), False)
    if image.dtype != np.uint8 or image.shape[2] not in (3, 4):
        expected = (
            f"{use.name} that is grey, or has colours of 8 bits, not {image.shape[2]} channels of"
            f" {8 * image.dtype.itemsize} bits"
        )
        raise InvalidInputError(use.field, str(path), expected)
    blue, green, red = np.moveaxis(image[..., :3].astype(np.int64), -1, 0)
    return LabelPixels(np.asarray(red << 16 | green << 8 | blue, np.int64), True)


def _number(value: str, is_color: bool) -> int | None:
    """Return the key of a mapping as a pixel value; None if no pixel can have it."""
    if not value.startswith("#"):
        return int(value) * 0x010101 if is_color else int(value)
    color = int(value[1:], 16)
    if is_color:
        return color
    grey = color & 0xFF
    return grey if color == grey * 0x010101 else None
