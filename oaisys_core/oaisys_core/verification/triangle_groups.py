"""Runs of triangles of one object, and which of them a part of an image can show.

Worlds of plants have tens of millions of triangles, of which a view shows few: whole objects are
left out by their bounding boxes before the triangles of the others are tested.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

MAX_TRIANGLES = 2048
"""Of a group; the ground's mesh is cut into many."""

TRIANGLES_AT_ONCE = 1_000_000

CORNERS = np.array(np.meshgrid((0, 1), (0, 1), (0, 1))).reshape(3, 8).T
"""(8, 3) which end of each axis a box's corners take: 0 for the lower one."""


class TriangleGroups:
    """The bounding boxes of runs of triangles that have the same id."""

    def __init__(
        self, vertices_m: FloatArray, triangles: NDArray[np.int32], ids: NDArray[np.uint32]
    ) -> None:
        """Take (V, 3) vertices in ``map``, (T, 3) triangles, and (T,) ids."""
        changes = np.flatnonzero(np.diff(ids)) + 1
        regular = np.arange(0, len(triangles), MAX_TRIANGLES)
        self._starts = np.union1d(regular, changes)
        self._ends = np.append(self._starts[1:], len(triangles))
        self._low_m = np.empty((len(self._starts), 3))
        self._high_m = np.empty_like(self._low_m)
        for groups in self._blocks():
            first = self._starts[groups.start]
            corners_m = vertices_m[triangles[first : self._ends[groups.stop - 1]]]
            starts = self._starts[groups] - first
            self._low_m[groups] = np.minimum.reduceat(corners_m.min(axis=1), starts)
            self._high_m[groups] = np.maximum.reduceat(corners_m.max(axis=1), starts)

    def visible_in(
        self, R: FloatArray, origin_m: FloatArray, boxes: Iterable[FloatArray]
    ) -> NDArray[np.int64]:
        """Return the indices of all triangles that a camera may see in parts of its image.

        Args:
            R: (3, 3) rotation from the camera's optical frame to ``map``.
            origin_m: (3,) its position in ``map``.
            boxes: (min_x, min_y, max_x, max_y) of each part, in the plane z = 1.
        """
        box_m = np.stack((self._low_m, self._high_m), axis=1)
        corners_m = (box_m[:, CORNERS, np.arange(3)] - origin_m) @ R
        depth_m = corners_m[..., 2]
        is_whole, is_ahead = (depth_m > 0).all(axis=1), (depth_m > 0).any(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            image = corners_m[..., :2] / depth_m[..., None]
        low, high = image.min(axis=1), image.max(axis=1)
        overlaps = np.zeros(len(low), bool)
        for x0, y0, x1, y1 in boxes:
            overlaps |= (low <= (x1, y1)).all(axis=1) & (high >= (x0, y0)).all(axis=1)
        # A box that is partly behind the camera may be anywhere in the image.
        found = np.flatnonzero(is_ahead & (overlaps | ~is_whole))
        ranges = [np.arange(self._starts[group], self._ends[group]) for group in found]
        return np.concatenate(ranges) if ranges else np.zeros(0, np.int64)

    def _blocks(self) -> Iterable[slice]:
        """Yield runs of groups that have about `TRIANGLES_AT_ONCE` triangles together."""
        first = 0
        while first < len(self._starts):
            most = self._starts[first] + TRIANGLES_AT_ONCE
            last = max(first + 1, int(np.searchsorted(self._ends, most, side="right")))
            yield slice(first, last)
            first = last
