"""All levels of a texture in one image, so that one call looks up points of different levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

ROW = 512
"""Points in a row of the arrays that OpenCV is given; it takes 32,766 at most."""

Floats = NDArray[np.float32]


class TextureAtlas:
    """The levels of a tileable square texture, each with a border of texels that wrap around."""

    def __init__(self, levels: Sequence[NDArray[Any]]) -> None:
        """Copy (S, S, C) or (S, S) levels, the finest first; row 0 is the top of a tile."""
        sizes = [len(level) for level in levels]
        rest = sum(size + 2 for size in sizes[1:])
        width = sizes[0] + 2 + (sizes[1] + 2 if len(sizes) > 1 else 0)
        shape = (max(sizes[0] + 2, rest), width, *levels[0].shape[2:])
        self.image = np.zeros(shape, levels[0].dtype)
        self._sizes = np.array(sizes, np.float32)
        lefts = [0] + [sizes[0] + 2] * (len(sizes) - 1)
        tops = [0, *np.cumsum([0, *(size + 2 for size in sizes[1:])])[: len(sizes) - 1]]
        for level, left, top in zip(levels, lefts, tops, strict=True):
            padded = np.pad(level, ((1, 1), (1, 1), *[(0, 0)] * (level.ndim - 2)), mode="wrap")
            self.image[top : top + len(padded), left : left + len(padded)] = padded
        self._lefts = np.array(lefts, np.float32) + np.float32(0.5)
        self._tops = np.array(tops, np.float32) + np.float32(0.5)

    def places(self, uv_tiles: FloatArray, level: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return (N,) columns and rows of (N, 2) texture coordinates at (N,) levels."""
        u, v = ((each - np.floor(each)).astype(np.float32) for each in uv_tiles.T)
        size = self._sizes.take(level)
        u *= size
        u += self._lefts.take(level)
        v *= -size
        v += (self._tops + self._sizes).take(level)
        return u, v

    def look_up(
        self, places: tuple[Floats, Floats], table: NDArray[np.float32] | None = None
    ) -> NDArray[Any]:
        """Return the (N, C) or (N,) texels, interpolated between their centres.

        ``table`` is as `sample` has it.
        """
        return sample(self.image, *places, table=table)


def sample(
    image: NDArray[Any],
    x: Floats,
    y: Floats,
    border: int = cv2.BORDER_REPLICATE,
    table: NDArray[np.float32] | None = None,
) -> NDArray[Any]:
    """Return the (N, C) or (N,) values of an image, interpolated at (N,) columns and rows.

    Args:
        image: (R, C) or (R, C, channels).
        x, y: Columns and rows.
        border: OpenCV's, for places outside.
        table: (1, 256, channels) values to return instead of bytes.
    """
    count = len(x)
    if not count:
        return np.zeros((0, *image.shape[2:]), image.dtype)
    rows = -(-count // ROW)
    at = np.zeros((2, rows * ROW), np.float32)
    at[0, :count], at[1, :count] = x, y
    at = at.reshape(2, rows, ROW)
    found = cv2.remap(image, at[0], at[1], cv2.INTER_LINEAR, borderMode=border)
    if table is not None:
        found = cv2.LUT(found, table)
    return np.asarray(found.reshape(rows * ROW, *found.shape[2:])[:count], order="F")
