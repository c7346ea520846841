"""Snow that lies on a ground: it raises it, less towards its borders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.processes.exact import smooth
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray

RIM = 0.4
"""Depth at a border, relative to that inside."""

RIM_DEPTHS = 1.8
"""Standard deviation of the distance from the border over which snow becomes deep, in depths."""


def lay_snow(ground: HeightField, share: NDArray[np.float32], depth_m: float) -> HeightField:
    """Return a ground under snow.

    Args:
        ground: The ground below it.
        share: (M, M) share of snow at the middles of cells of the ground; row 0 at its smallest y.
        depth_m: Depth of the snow inside.
    """
    rows, columns = ground.elevation_m.shape
    on_rows = _between(share.astype(np.float64), rows)
    on_grid = _between(on_rows.T, columns).T
    inside = smooth(on_grid, RIM_DEPTHS * depth_m / ground.spacing_m)
    snow_m = depth_m * on_grid * (RIM + (1 - RIM) * inside)
    return replace(ground, elevation_m=(ground.elevation_m + snow_m).astype(np.float32))


def _between(cells: FloatArray, points: int) -> FloatArray:
    """Return values between the middles of rows of cells, at points from edge to edge."""
    at = np.clip(np.linspace(0, len(cells), points) - 0.5, 0, len(cells) - 1)
    lower = np.minimum(at.astype(np.intp), max(len(cells) - 2, 0))
    upper = np.minimum(lower + 1, len(cells) - 1)
    share = (at - lower)[:, None]
    return np.asarray(cells[lower] * (1 - share) + cells[upper] * share)
