"""Rays of a camera and triangles, with nothing but NumPy: slow, and independent of Embree.

Which triangle a ray meets is found after Möller and Trumbore, "Fast, Minimum Storage Ray/Triangle
Intersection", 1997, in float64; a triangle is tried where its image's box meets that of the rays.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

NO_TRIANGLE = -1
"""Triangle of a ray that meets none."""

MOST_PAIRS = 1_000_000
"""Rays times triangles that are tried at once."""

SLACK = 1e-9
"""Share of a triangle by which it is held to be larger, so that no ray passes between two."""


class NumpyCaster:
    """Casts rays from a camera's centre."""

    def __init__(self, points_m: FloatArray, triangles: NDArray[np.int64]) -> None:
        """Take (V, 3) vertices in the camera's optical frame and (T, 3) triangles."""
        depth_m = points_m[:, 2]
        is_ahead = (depth_m > 0)[triangles]
        with np.errstate(divide="ignore", invalid="ignore"):
            image = (points_m[:, :2] / depth_m[:, None])[triangles]
        # A triangle beside the camera that is ahead in part may be anywhere in the image.
        part = ~is_ahead.all(axis=1)
        low, high = image.min(axis=1), image.max(axis=1)
        low[part], high[part] = -np.inf, np.inf
        self._ids = np.flatnonzero(is_ahead.any(axis=1))
        # Four arrays of one number each: far quicker to compare than pairs.
        self._box = np.stack((*low[self._ids].T, *high[self._ids].T))
        self._points_m, self._triangles = points_m, triangles

    def nearest(self, rays: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return (H, W) depths that (H, W, 3) rays of planar length 1 go, and (H, W) triangles.

        The depth is ``+inf``, and the triangle `NO_TRIANGLE`, where a ray meets none.
        """
        flat = rays.reshape(-1, 3)
        low, high = flat[:, :2].min(axis=0), flat[:, :2].max(axis=0)
        candidates = np.flatnonzero(_overlap(self._box, (*low, *high)))
        depth_m = np.full(len(flat), np.inf)
        found = np.full(len(flat), NO_TRIANGLE, np.int64)
        step = max(1, MOST_PAIRS // len(flat))
        for first in range(0, len(candidates), step):
            some = candidates[first : first + step]
            x, y = flat[:, 0, None], flat[:, 1, None]
            ray, place = np.nonzero(_overlap(self._box[:, some], (x, y, x, y)))
            triangle = self._ids[some[place]]
            distances = _distances(flat[ray], self._points_m[self._triangles[triangle]])
            # Of each ray the nearest comes last.
            order = np.lexsort((-distances, ray))
            nearest, ids = np.full(len(flat), np.inf), np.full(len(flat), NO_TRIANGLE)
            nearest[ray[order]], ids[ray[order]] = distances[order], triangle[order]
            nearer = nearest < depth_m
            depth_m[nearer], found[nearer] = nearest[nearer], ids[nearer]
        return depth_m.reshape(rays.shape[:-1]), found.reshape(rays.shape[:-1])


def _overlap(box: FloatArray, other: tuple[Any, Any, Any, Any]) -> NDArray[np.bool_]:
    """Return where boxes (4, T) and another overlap; each has its low x and y, then its high."""
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
