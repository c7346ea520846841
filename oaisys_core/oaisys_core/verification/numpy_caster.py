"""Ray casting with NumPy alone: slow, and independent of Embree.

The intersection test is that of Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle
Intersection", 1997, in float64. Only triangles whose bounding box in the image overlaps that of the
rays are tested.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

NO_TRIANGLE = -1
"""Triangle index of a ray that hits nothing."""

MAX_PAIRS = 1_000_000
"""Number of ray-triangle pairs that are tested at once."""

SLACK = 1e-9
"""Relative enlargement of triangles, so that no ray passes between two of them."""


class NumpyCaster:
    """Casts rays from a camera's centre."""

    def __init__(self, points_m: FloatArray, triangles: NDArray[np.int64]) -> None:
        """Take (V, 3) vertices in the camera's optical frame and (T, 3) triangles."""
        depth_m = points_m[:, 2]
        is_ahead = (depth_m > 0)[triangles]
        with np.errstate(divide="ignore", invalid="ignore"):
            image = (points_m[:, :2] / depth_m[:, None])[triangles]
        # A triangle that is partly behind the camera may be anywhere in the image.
        part = ~is_ahead.all(axis=1)
        low, high = image.min(axis=1), image.max(axis=1)
        low[part], high[part] = -np.inf, np.inf
        self._ids = np.flatnonzero(is_ahead.any(axis=1))
        # Four separate rows are much faster to compare than pairs.
        self._box = np.stack((*low[self._ids].T, *high[self._ids].T))
        self._points_m, self._triangles = points_m, triangles

    def nearest(self, rays: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return (H, W) planar depths and (H, W) triangle indices of (H, W, 3) rays with z = 1.

        For rays without a hit, the depth is ``+inf`` and the index `NO_TRIANGLE`.
        """
        flat = rays.reshape(-1, 3)
        low, high = flat[:, :2].min(axis=0), flat[:, :2].max(axis=0)
        candidates = np.flatnonzero(_overlap(self._box, (*low, *high)))
        depth_m = np.full(len(flat), np.inf)
        found = np.full(len(flat), NO_TRIANGLE, np.int64)
        step = max(1, MAX_PAIRS // len(flat))
        for first in range(0, len(candidates), step):
            some = candidates[first : first + step]
            x, y = flat[:, 0, None], flat[:, 1, None]
            ray, place = np.nonzero(_overlap(self._box[:, some], (x, y, x, y)))
            triangle = self._ids[some[place]]
            distances = _distances(flat[ray], self._points_m[self._triangles[triangle]])
            # The nearest triangle of each ray comes last.
            order = np.lexsort((-distances, ray))
            nearest, ids = np.full(len(flat), np.inf), np.full(len(flat), NO_TRIANGLE)
            nearest[ray[order]], ids[ray[order]] = distances[order], triangle[order]
            nearer = nearest < depth_m
            depth_m[nearer], found[nearer] = nearest[nearer], ids[nearer]
        return depth_m.reshape(rays.shape[:-1]), found.reshape(rays.shape[:-1])


def _overlap(box: FloatArray, other: tuple[Any, Any, Any, Any]) -> NDArray[np.bool_]:
    """Return which boxes (4, T) overlap another box; boxes are (min_x, min_y, max_x, max_y)."""
    x0, y0, x1, y1 = box
    low_x, low_y, high_x, high_y = other
    return np.asarray((x0 <= high_x) & (y0 <= high_y) & (x1 >= low_x) & (y1 >= low_y))


def _distances(rays: FloatArray, corners: FloatArray) -> FloatArray:
    """Return (N,) distances along (N, 3) rays from the origin to (N, 3, 3) triangles."""
    a, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p, q = np.cross(rays, c), np.cross(-a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / (b * p).sum(axis=1)
        u, v = -(a * p).sum(axis=1) * inverse, (rays * q).sum(axis=1) * inverse
        t = (c * q).sum(axis=1) * inverse
        inside = (u >= -SLACK) & (v >= -SLACK) & (u + v <= 1 + SLACK) & (t > 0)
    return np.where(inside, t, np.inf)
