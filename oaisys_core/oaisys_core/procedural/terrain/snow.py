"""Snow that lies on a ground: it raises it, less towards its borders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.processes.exact import smooth
from oaisys_core.scene import HeightField

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
    edges = zip(share.shape, ground.elevation_m.shape, strict=True)
    at = np.meshgrid(*(np.linspace(0, n, points) - 0.5 for n, points in edges), indexing="ij")
    on_grid = scipy.ndimage.map_coordinates(share, at, np.float64, order=1, mode="nearest")
    inside = smooth(on_grid, RIM_DEPTHS * depth_m / ground.spacing_m)
    snow_m = depth_m * on_grid * (RIM + (1 - RIM) * inside)
    return replace(ground, elevation_m=(ground.elevation_m + snow_m).astype(np.float32))
