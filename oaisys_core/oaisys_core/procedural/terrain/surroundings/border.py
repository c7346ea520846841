"""The edge of a stage, and how its heights go on smoothly beyond it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.scene import Ground, HeightField
from oaisys_core.types import Extent, FloatArray

MESH_POINTS = 192
"""Points along each side of a stage that is no grid."""

MESH_INSET = 1e-4
"""Share of the stage by which these are sampled inside: a mesh has no heights on its edge."""

SETTLED = 12.0
"""Number of decay lengths after which the stage's edge has no influence."""


class Border(NamedTuple):
    """The edge of a stage, counter-clockwise from the corner (min_x, min_y).

    Attributes:
        extent_m: (min_x, min_y, max_x, max_y).
        cells: Number of cells along a side in x, and along one in y.
        height_m: (P,) float64 heights of its points, evenly spaced along each side.
        slope: (P,) outward slope of the stage at these points.
    """

    extent_m: tuple[float, float, float, float]
    cells: tuple[int, int]
    height_m: FloatArray
    slope: FloatArray

    @property
    def size_m(self) -> tuple[float, float]:
        """Lengths of the sides in x and in y."""
        x0, y0, x1, y1 = self.extent_m
        return x1 - x0, y1 - y0

    @property
    def level_m(self) -> float:
        """The mean height."""
        return float(self.height_m.mean())

    def distance_m(self, xy_m: FloatArray) -> FloatArray:
        """Return the (N,) distances of (N, 2) points from the stage, 0 on it."""
        return distance_from_m(self.extent_m, xy_m)


def distance_from_m(extent_m: Extent, xy_m: FloatArray) -> FloatArray:
    """Return the (N,) distances of (N, 2) points from a rectangle, 0 on it."""
    x0, y0, x1, y1 = extent_m
    outside = np.maximum(np.maximum((x0, y0) - xy_m, xy_m - (x1, y1)), 0.0)
    return np.hypot(outside[:, 0], outside[:, 1])


def border_of(stage: Ground) -> Border:
    """Return the edge of a stage; heights that it does not have are interpolated along the edge."""
    if isinstance(stage, HeightField):
        z = stage.elevation_m.astype(np.float64)
        rows, cols = z.shape
        edge_m = _around(z[0], z[:, -1], z[-1], z[:, 0])
        inside_m = _around(z[1], z[:, -2], z[-2], z[:, 1])
        slope = (edge_m - inside_m) / stage.spacing_m
        return Border(stage.extent_m, (cols - 1, rows - 1), edge_m, slope)
    x0, y0, x1, y1 = stage.extent_m
    t = np.linspace(-1.0, 1.0, MESH_POINTS + 1)
    one = np.ones_like(t)
    x, y = _around(t, one, t, -one), _around(-one, t, one, t)
    centre_m, half_m = ((x0 + x1) / 2, (y0 + y1) / 2), ((x1 - x0) / 2, (y1 - y0) / 2)
    unit = np.column_stack((x, y)) * (1 - MESH_INSET)
    height_m = stage.height_at(centre_m + unit * half_m)
    known = np.flatnonzero(np.isfinite(height_m))
    if len(known):
        places = np.arange(len(height_m))
        height_m = np.interp(places, known, height_m[known], period=len(height_m))
    else:
        height_m = np.zeros(len(height_m))
    return Border(stage.extent_m, (MESH_POINTS, MESH_POINTS), height_m, np.zeros_like(height_m))


def _around(
    south: NDArray[np.float64],
    east: NDArray[np.float64],
    north: NDArray[np.float64],
    west: NDArray[np.float64],
) -> FloatArray:
    """Return the values of four sides, each in the direction of its axis, as one loop."""
    return np.concatenate((south[:-1], east[:-1], north[:0:-1], west[:0:-1]))


class BorderContinuation:
    """Continues the heights of a border outward, smoothly and without its fine structure.

    Along the border, a wave of heights fades within a fraction of its length, as a potential does
    outside of a plane; the outward slope goes on and fades alike.
    """

    def __init__(self, border: Border) -> None:
        count = len(border.height_m)
        perimeter_m = 2 * sum(border.size_m)
        # Without the constant, the mean slope would go on for ever.
        self._decay = 2 * np.pi / perimeter_m * np.arange(count // 2 + 1)
        self._decay += 2.0 / min(border.size_m)
        self._height = scipy.fft.rfft(border.height_m - border.level_m)
        self._rise = scipy.fft.rfft(border.slope) + self._decay * self._height
        self._count, self._level_m = count, border.level_m
        self._settled_m = SETTLED / self._decay[0]

    def at(self, offset_m: float, places: FloatArray) -> FloatArray:
        """Return (N,) heights at a distance from the border.

        Args:
            offset_m: The distance.
            places: (N,) places along the border in its points, from 0.
        """
        if offset_m > self._settled_m:
            return np.full(len(places), self._level_m)
        waves = (self._height + offset_m * self._rise) * np.exp(-self._decay * offset_m)
        along_m = scipy.fft.irfft(waves, self._count)
        return self._level_m + np.interp(
            places, np.arange(self._count), along_m, period=self._count
        )
