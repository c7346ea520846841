"""The shift between a reconstruction and the truth, by translation-only point-to-plane ICP.

On level ground, a map shifted sideways by 2 cm is still within millimetres of the truth, so
distances hide the shift. ICP (Chen and Medioni, "Object modelling by registration of multiple range
images", 1992) finds it from the slopes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import open3d as o3d

from oaisys_core.types import FloatArray

MAX_POINTS = 60_000
MAX_ITERATIONS = 8
CONVERGED_M = 1e-6

MIN_POINTS = 3
"""Points near the truth without which there is no offset."""

MIN_EIGENVALUE = 1e-4
"""Least mean square of the normals along an observable direction: slopes of 0.6 degrees. A shift
along level ground cannot be measured."""

OUTLIER_MADS = 3.0
"""Residuals further from their median than this many (normalised) median absolute deviations are
outliers, such as rounded edges and artefacts."""

MIN_DEVIATION_M = 1e-4
"""Lower limit of the deviation, so that a perfect map has no outliers."""


def offset_to_truth(points_m: FloatArray, truth_scene: Any, reach_m: float) -> FloatArray:
    """Return the (3,) shift of the reconstruction from the truth, in metres.

    It is 0 along directions that the surface does not constrain.

    Args:
        points_m: (N, 3) points on the reconstruction, spread evenly.
        truth_scene: `raycasting_scene` of the truth.
        reach_m: Points further than this from the truth are ignored.
    """
    offset_m = np.zeros(3)
    points_m = points_m[:: max(1, len(points_m) // MAX_POINTS)]
    for _ in range(MAX_ITERATIONS):
        normals, gap_m = _residuals(points_m - offset_m, truth_scene, reach_m)
        if len(gap_m) < MIN_POINTS:
            break
        step_m = _least_squares(normals, gap_m)
        offset_m += step_m
        if np.linalg.norm(step_m) < CONVERGED_M:
            break
    return offset_m


def _residuals(
    points_m: FloatArray, truth_scene: Any, reach_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return (K, 3) normals of the nearest truth and (K,) signed distances to its planes."""
    query = o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
    found = truth_scene.compute_closest_points(query)
    away_m = points_m - found["points"].numpy()
    normals = found["primitive_normals"].numpy().astype(np.float64)
    height_m = (normals * away_m).sum(axis=1)
    is_near = np.linalg.norm(away_m, axis=1) <= reach_m
    if not is_near.any():
        return normals[:0], height_m[:0]
    median_m = np.median(height_m[is_near])
    deviation_m = max(
        1.4826 * float(np.median(np.abs(height_m[is_near] - median_m))), MIN_DEVIATION_M
    )
    kept = is_near & (np.abs(height_m - median_m) <= OUTLIER_MADS * deviation_m)
    return normals[kept], height_m[kept]


def _least_squares(normals: FloatArray, height_m: FloatArray) -> FloatArray:
    """Return the (3,) shift that explains the heights, along constrained directions."""
    eigenvalues, axes = np.linalg.eigh(normals.T @ normals / len(normals))
    along = axes.T @ (normals.T @ height_m / len(normals))
    constrained = eigenvalues >= MIN_EIGENVALUE
    return np.asarray(axes[:, constrained] @ (along[constrained] / eigenvalues[constrained]))
