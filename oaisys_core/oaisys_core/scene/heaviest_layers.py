"""Where one layer of the ground is the heaviest for certain, so that its label needs no weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

UNCERTAIN = -1
"""Instead of a layer, where the weights at the very point decide."""

MIN_LEAD = 1e-5
"""Least lead of the heaviest layer: far more than the rounding of interpolated weights."""


class HeaviestLayers:
    """The heaviest layer of each cell between four texels of the masks.

    A layer that leads at all four texels leads anywhere between them, by any bilinear weights.
    """

    def __init__(
        self, masks: NDArray[np.float32], extent_m: tuple[float, float, float, float]
    ) -> None:
        """Compare the (L, S, S) weights of at least two layers; row 0 is at the lowest y."""
        self._extent_m = extent_m
        first = masks.argmax(axis=0)
        lead = np.partition(masks, len(masks) - 2, axis=0)
        is_clear = lead[-1] - lead[-2] >= MIN_LEAD
        layers = np.where(is_clear, first, UNCERTAIN).astype(np.int16)
        cells = layers[:-1, :-1].copy()
        for corner in (layers[:-1, 1:], layers[1:, :-1], layers[1:, 1:]):
            cells[corner != cells] = UNCERTAIN
        self._size = len(cells)
        self._cells = cells.reshape(-1)

    def at(self, xy_m: FloatArray) -> NDArray[np.intp]:
        """Return the (N,) heaviest layers at (N, 2) points, or `UNCERTAIN`, as outside."""
        x0, y0, x1, y1 = self._extent_m
        size = self._size
        place = np.zeros(len(xy_m), np.intp)
        outside: list[NDArray[np.bool_]] = []
        for axis, (low_m, high_m) in ((1, (y0, y1)), (0, (x0, x1))):
            per_m = (size + 1) / (high_m - low_m)
            texel = xy_m[:, axis] * per_m
            texel -= low_m * per_m + 0.5
            if len(texel) and not (texel.min() >= 0 and texel.max() < size):
                outside.append(~((texel >= -0.5) & (texel <= size + 0.5)))
                np.clip(np.nan_to_num(texel, copy=False), 0, size - 1, out=texel)
            place *= size
            place += texel.astype(np.intp)
        layers = self._cells.take(place).astype(np.intp)
        for each in outside:
            layers[each] = UNCERTAIN
        return layers
