"""All levels of a texture in one image, so that one call looks up points of different levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.types import FloatArray

MAX_COLUMNS = 32_766
"""Most points in a row of the arrays that OpenCV is given."""

Floats = NDArray[np.float32]

Levels = NDArray[np.uint8]
"""Levels of detail, as bytes: OpenCV looks those up thrice as fast as NumPy looks up integers."""


class LevelTable:
    """A number for each level of detail."""

    def __init__(self, values: ArrayLike) -> None:
        """Take over (L,) values; L is 256 at most."""
        self._values = np.zeros(256, np.float32)
        self._values[: np.size(values)] = values

    def take(self, level: Levels) -> Floats:
        """Return the (N,) values of (N,) levels."""
        values = np.empty(len(level), np.float32)
        cv2.LUT(level, self._values, dst=values)
        return values


class TextureAtlas:
    """The levels of a tileable square texture, each with a border of texels that wrap around."""

    def __init__(
        self, levels: Sequence[NDArray[Any]], level_of: NDArray[np.intp] | None = None
    ) -> None:
        """Copy (S, S, C) or (S, S) levels, the finest first; row 0 is the top of a tile.

        ``level_of`` are the levels that are meant by the numbers of other ones; None: themselves.
        """
        sizes = [len(level) for level in levels]
        rest = sum(size + 2 for size in sizes[1:])
        width = sizes[0] + 2 + (sizes[1] + 2 if len(sizes) > 1 else 0)
        shape = (max(sizes[0] + 2, rest), width, *levels[0].shape[2:])
        self.image = np.zeros(shape, levels[0].dtype)
        lefts = [0] + [sizes[0] + 2] * (len(sizes) - 1)
        tops = [0, *np.cumsum([0, *(size + 2 for size in sizes[1:])])[: len(sizes) - 1]]
        for level, left, top in zip(levels, lefts, tops, strict=True):
            padded = np.pad(level, ((1, 1), (1, 1), *[(0, 0)] * (level.ndim - 2)), mode="wrap")
            self.image[top : top + len(padded), left : left + len(padded)] = padded
        numbers = np.arange(len(sizes)) if level_of is None else level_of
        self._sizes = LevelTable(np.array(sizes)[numbers])
        self._lefts = LevelTable(np.array(lefts)[numbers] + 0.5)
        self._bottoms = LevelTable((np.array(tops) + np.array(sizes))[numbers] + 0.5)

    def places(
        self, uv_tiles: tuple[FloatArray, FloatArray], level: Levels
    ) -> tuple[Floats, Floats]:
        """Return (N,) columns and rows of (N,) texture coordinates u and v at (N,) levels."""
        u, v = map(fraction, uv_tiles)
        size = self._sizes.take(level)
        u *= size
        u += self._lefts.take(level)
        v *= size
        return u, self._bottoms.take(level) - v

    def look_up(
        self, places: tuple[Floats, Floats], table: NDArray[np.float32] | None = None
    ) -> NDArray[Any]:
        """Return the (N, C) or (N,) texels, interpolated between their centres.

        ``table`` is as `sample` has it.
        """
        return sample(self.image, *places, table=table)


def fraction(values: FloatArray) -> Floats:
    """Return (N,) values without their whole parts."""
    return np.asarray(values - np.floor(values), np.float32)


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
        table: (channels or fewer, 256) values to return instead of bytes, of the first channels.
    """
    count = len(x)
    if not count:
        return np.zeros((0, *image.shape[2:]), image.dtype)
    rows = -(-count // MAX_COLUMNS)
    columns = -(-count // rows)
    rest = rows * columns - count
    if rest:
        x, y = np.append(x, x[:rest]), np.append(y, y[:rest])
    shape = rows, columns
    at = x.reshape(shape), y.reshape(shape)
    found = cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=border)
    if found.ndim == 2:
        return np.asarray(found.reshape(-1)[:count])
    channels = np.empty((found.shape[2], rows * columns), image.dtype)
    cv2.split(found, list(channels.reshape(-1, *shape)))
    if table is not None:
        channels = _decode(channels, table)
    return channels[:, :count].T


def _decode(channels: NDArray[np.uint8], table: NDArray[np.float32]) -> Floats:
    """Return the (C, N) values that tables of (C, 256) give for the first C channels of bytes."""
    decoded = np.empty((len(table), channels.shape[1]), np.float32)
    for channel, values, into in zip(channels, table, decoded, strict=False):
        cv2.LUT(channel, values, dst=into)
    return decoded
