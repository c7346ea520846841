"""Which of many parallel rays may hit any of many boxes, looked up in a plane across them."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

CELLS = 512
"""Cells along each edge of the plane's grid."""

MIN_UP = 0.03
"""Least vertical component of rays, below which the plane is too far away."""

MARGIN_M = 1e-3
"""Added to boxes on all sides; more than the rounding of positions."""


class ShadowPlane:
    """The shadows of boxes on the level plane at height 0, as a grid."""

    def __init__(self, direction: FloatArray, low_m: FloatArray, high_m: FloatArray) -> None:
        """Draw the shadows.

        Args:
            direction: (3,) of the rays, upward.
            low_m, high_m: (N, 3) corners of the boxes.
        """
        self._lean = direction[:2] / direction[2]
        corners = [
            self._onto_plane(np.where(choice, high_m + MARGIN_M, low_m - MARGIN_M))
            for choice in product((False, True), repeat=3)
        ]
        first_m, last_m = np.min(corners, axis=0), np.max(corners, axis=0)
        self._start_m = first_m.min(axis=0)
        self._per_m = CELLS / np.maximum(last_m.max(axis=0) - self._start_m, 1e-9)
        first, last = self._cells(first_m), self._cells(last_m)
        # A summed-area table of the rectangles' corners.
        steps = np.zeros((CELLS + 1, CELLS + 1), np.int32)
        np.add.at(steps, (first[:, 1], first[:, 0]), 1)
        np.add.at(steps, (last[:, 1] + 1, first[:, 0]), -1)
        np.add.at(steps, (first[:, 1], last[:, 0] + 1), -1)
        np.add.at(steps, (last[:, 1] + 1, last[:, 0] + 1), 1)
        counts = steps.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
        self._is_shadow = counts[:CELLS, :CELLS] > 0

    def may_hit(self, origins_m: FloatArray) -> NDArray[np.bool_]:
        """Return (R,) whether rays from (R, 3) origins may hit a box."""
        may = np.ones(len(origins_m), np.bool_)
        cell = np.zeros(len(origins_m), np.intp)
        # By component: loops over two values at a time take five times as long.
        for axis in (1, 0):
            on_plane_m = origins_m[:, axis] - origins_m[:, 2] * self._lean[axis]
            place = (on_plane_m - self._start_m[axis]) * self._per_m[axis]
            is_inside = (place >= 0) & (place < CELLS)
            may &= is_inside
            cell *= CELLS
            cell += np.where(is_inside, place, 0.0).astype(np.intp)
        may &= self._is_shadow.reshape(-1).take(cell)
        return may

    def _onto_plane(self, points_m: FloatArray) -> FloatArray:
        return np.asarray(points_m[:, :2] - points_m[:, 2:] * self._lean)

    def _cells(self, places_m: FloatArray) -> NDArray[np.intp]:
        cells = ((places_m - self._start_m) * self._per_m).astype(np.intp)
        return np.asarray(np.clip(cells, 0, CELLS - 1))
