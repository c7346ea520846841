"""The shift that would lay a reconstruction on the truth: a bias that distances may hide.

A map that is 2 cm beside the truth is nearly everywhere within millimetres of it where the ground
is level. Point-to-plane registration of the translation alone (Chen and Medioni, "Object modelling
by registration of multiple range images", 1992) finds it from whatever slopes there are.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import open3d as o3d

from oaisys_core.types import FloatArray

MOST_POINTS = 60_000
STEPS = 8
ENOUGH_M = 1e-6

LEAST_SLOPE = 1e-4
"""A direction is found if the mean square of the normals along it reaches this: slopes of 0.6
degrees. On level ground a shift along it changes nothing that could be measured."""

OUTLIER_MADS = 3.0
"""Residuals further from their median than so many median absolute deviations (made to be a
normal distribution's) are left out: rounded edges and artefacts, not the surface."""

LEAST_SPREAD_M = 1e-4
"""The deviation counts as at least this, so that a perfect map has no outliers."""


def offset_to_truth(points_m: FloatArray, truth_scene: Any, reach_m: float) -> FloatArray:
    """Return (3,) how far the reconstruction lies beside the truth, in metres.

    Directions in which the surface does not fix it are left out: they count as 0.

    Args:
        points_m: (N, 3) points on the reconstruction, spread evenly.
        truth_scene: The truth, as `raycasting_scene` makes it.
        reach_m: Points that are further away belong to nothing of the truth.
    """
    offset_m = np.zeros(3)
    points_m = points_m[:: max(1, len(points_m) // MOST_POINTS)]
    for _ in range(STEPS):
        normals, gap_m = _residuals(points_m - offset_m, truth_scene, reach_m)
        if len(gap_m) < 3:
            break
        step_m = _least_squares(normals, gap_m)
        offset_m += step_m
        if np.linalg.norm(step_m) < ENOUGH_M:
            break
    return offset_m


def _residuals(
    points_m: FloatArray, truth_scene: Any, reach_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return (K, 3) normals of the nearest truth and (K,) heights over its planes."""
    query = o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
    found = truth_scene.compute_closest_points(query)
    away_m = points_m - found["points"].numpy()
    normals = found["primitive_normals"].numpy().astype(np.float64)
    height_m = (normals * away_m).sum(axis=1)
    is_near = np.linalg.norm(away_m, axis=1) <= reach_m
    if not is_near.any():
        return normals[:0], height_m[:0]
    middle_m = np.median(height_m[is_near])
    spread_m = max(1.4826 * float(np.median(np.abs(height_m[is_near] - middle_m))), LEAST_SPREAD_M)
    kept = is_near & (np.abs(height_m - middle_m) <= OUTLIER_MADS * spread_m)
    return normals[kept], height_m[kept]


def _least_squares(normals: FloatArray, height_m: FloatArray) -> FloatArray:
    """Return the (3,) shift that explains the heights, along directions that they fix."""
    slopes, axes = np.linalg.eigh(normals.T @ normals / len(normals))
    along = axes.T @ (normals.T @ height_m / len(normals))
    fixed = slopes >= LEAST_SLOPE
    return np.asarray(axes[:, fixed] @ (along[fixed] / slopes[fixed]))
