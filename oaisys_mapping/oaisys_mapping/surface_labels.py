"""Labels of a true surface at points on it."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.types import FloatArray, TriangleMesh

_MOST_PARTS = 64
"""Into which an edge of a triangle is divided."""


def labels_at(mesh: TriangleMesh, points_m: FloatArray, spacing_m: float) -> NDArray[np.uint16]:
    """Return the labels (N,) of the triangles on which (N, 3) points lie; 0 where unknown.

    Each triangle near the points is divided into samples that are at most ``spacing_m`` apart; a
    point gets the label of the nearest one. NaN is on no triangle.
    """
    found = np.zeros(len(points_m), np.uint16)
    known = np.isfinite(points_m).all(axis=1)
    if mesh.semantic_ids is None or not known.any():
        return found
    corners_m = mesh.vertices_m[mesh.triangles]
    low_m, high_m = points_m[known].min(axis=0) - spacing_m, points_m[known].max(axis=0) + spacing_m
    is_near = (corners_m.max(axis=1) >= low_m).all(axis=1)
    is_near &= (corners_m.min(axis=1) <= high_m).all(axis=1)
    if not is_near.any():
        return found
    samples_m, triangle = _sample(corners_m[is_near], spacing_m)
    inside = ((samples_m >= low_m) & (samples_m <= high_m)).all(axis=1)
    if not inside.any():
        return found
    _, nearest = scipy.spatial.cKDTree(samples_m[inside]).query(points_m[known])
    found[known] = mesh.semantic_ids[is_near][triangle[inside]][nearest]
    return found


def _sample(corners_m: FloatArray, spacing_m: float) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return points on (T, 3, 3) triangles, and the index of the triangle of each."""
    edges_m = np.linalg.norm(corners_m - np.roll(corners_m, 1, axis=1), axis=2).max(axis=1)
    parts = np.clip(np.ceil(edges_m / spacing_m), 1, _MOST_PARTS).astype(int)
    points_m, triangles = [], []
    for number in np.unique(parts).tolist():
        chosen = np.flatnonzero(parts == number)
        a, b = (each.ravel() + 1 / 3 for each in np.mgrid[:number, :number])
        weights = np.stack((a, b, number - a - b), axis=-1)[a + b < number] / number
        points_m.append(np.einsum("wc,tcx->twx", weights, corners_m[chosen]).reshape(-1, 3))
        triangles.append(np.repeat(chosen, len(weights)))
    return np.concatenate(points_m), np.concatenate(triangles)
