"""How high the ground beyond a stage rises above the horizontal, as seen from the stage."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.scene import Ground
from oaisys_core.types import FloatArray

VIEW_SHARES = (1 / 6, 1 / 2, 5 / 6)
"""Places of the viewpoints along each side of the stage, as shares of its length."""

AZIMUTHS = 72
"""Number of equal ranges of azimuths."""


class HorizonView:
    """Finds the horizon that points beyond a stage make, for any heights of these points."""

    def __init__(self, stage: Ground, xy_m: FloatArray) -> None:
        """Compute what does not depend on the heights.

        Args:
            stage: What is looked from.
            xy_m: (N, 2) points beyond it.
        """
        x0, y0, x1, y1 = stage.extent_m
        shares = np.array(VIEW_SHARES)
        x, y = np.meshgrid(x0 + (x1 - x0) * shares, y0 + (y1 - y0) * shares)
        views_m = np.column_stack((x.ravel(), y.ravel()))
        self._view_heights_m = stage.height_at(views_m)
        self._away = [_distances_and_ranges(xy_m - view) for view in views_m]

    def elevations_rad(self, height_m: FloatArray) -> FloatArray:
        """Return the (AZIMUTHS,) elevations of the horizon, each the median of all viewpoints.

        Args:
            height_m: (N,) heights of the points.
        """
        steepest = np.full((len(self._away), AZIMUTHS), -np.inf)
        # A mesh has no heights where it has holes.
        usual_m = float(np.median(height_m))
        for slopes, view_m, (distance_m, ranges) in zip(
            steepest, self._view_heights_m, self._away, strict=True
        ):
            rise_m = height_m - (view_m if np.isfinite(view_m) else usual_m)
            np.maximum.at(slopes, ranges, rise_m / distance_m)
        return np.asarray(np.median(np.arctan(steepest), axis=0))


def range_of(azimuth_rad: ArrayLike) -> NDArray[np.intp]:
    """Return the index of the range of azimuths, as of `HorizonView`, of each azimuth."""
    turns = np.asarray(azimuth_rad, dtype=np.float64) / (2 * np.pi)
    return np.asarray(np.floor(turns * AZIMUTHS) % AZIMUTHS, dtype=np.intp)


def _distances_and_ranges(away_m: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the distances and the ranges of azimuths of (N, 2) points about a viewpoint."""
    distance_m = np.maximum(np.hypot(away_m[:, 0], away_m[:, 1]), 1e-9)
    return distance_m, range_of(np.arctan2(away_m[:, 1], away_m[:, 0]))
