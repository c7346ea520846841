"""The mantle of soil and debris on slopes: smooth ground, out of which rock stands.

Creep and slides fill the hollows of gentle slopes and leave the rock of steep ones bare (Heimsath
et al., "The soil production function and landscape equilibrium", Nature 388, 1997). So the surface
is the higher of two: the rock's, and that of a mantle which follows the slope at large, thick where
it is gentle and absent where it is steep.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oaisys_core.procedural.terrain.processes.exact import smooth, tangent
from oaisys_core.procedural.terrain.processes.slopes import steepness
from oaisys_core.types import FloatArray

THICKNESS = 0.18
"""Largest rise of the mantle above the mean of the rock, in the length that creep smooths."""

DEPTH, STEEPENING = 3.0, 4.0
"""Largest depth of the mantle below that mean, in the same, and by how much of it the mantle is
lower for each unit of slope above the angle of repose: rock that stands out more is bare."""

LEAST_CELLS = 1.5
"""Least length, in cells, at which the grid shows a mantle."""


def lay_mantle(
    elevation_m: FloatArray,
    spacing_m: float,
    height_m: float,
    lengths: Sequence[float],
    repose_deg: float,
) -> FloatArray:
    """Return (rows, cols) heights of a ground after soil and debris have filled its hollows.

    Args:
        elevation_m: (rows, cols) heights of the rock.
        spacing_m: Distance between cells.
        height_m: Height of the landform.
        lengths: Standard deviations of the Gaussians by which the mantle is smooth, in that height,
            the longest first: of debris, and of soil on its ledges.
        repose_deg: Slope from which on the mantle is thinner than the rock is uneven.
    """
    z = elevation_m.astype(np.float64)
    for length in lengths:
        length_m = length * height_m
        cells = length_m / spacing_m
        if cells < LEAST_CELLS:
            continue
        mean_m = smooth(z, cells)
        gentler = tangent(repose_deg) - steepness(mean_m, spacing_m)
        rise = np.clip(STEEPENING * gentler, -DEPTH, THICKNESS)
        z = np.maximum(z, mean_m + length_m * rise)
    return z
