"""How wet each place of a ground is, by the water that drains towards it."""

from __future__ import annotations

from typing import Any
from weakref import ref

import numpy as np
import scipy

from oaisys_core.procedural.terrain.erosion import drainage_area, receivers
from oaisys_core.procedural.terrain.masks.forces import ranks
from oaisys_core.scene import Ground
from oaisys_core.types import FloatArray

CELLS = 192
"""Cells along an edge of the ground."""

ROUNDS = 6
"""Drawings of the flow directions over which the drained area is averaged, so that water spreads
over convex slopes instead of following the grid."""

AROUND = 0.08
"""Distance of the surrounding ground, as a share of the stage's edge."""

WETNESS = 0.6
"""Weight of the wetness index beside the depth below the surrounding ground."""

MIN_SLOPE = 0.01
"""Slope below which ground does not get wetter."""

_last: list[tuple[Any, FloatArray]] = []
"""A weak reference to the last ground, and its moistures: several groups ask for them."""


def moisture(ground: Ground) -> FloatArray:
    """Return (CELLS, CELLS) moistures from 0 to 1, row 0 at the smallest y, by rank.

    They come from the ranks of the topographic wetness index, ln(a / tan(slope)) with the drained
    area ``a`` (Beven and Kirkby, "A physically based, variable contributing area model of basin
    hydrology", Hydrological Sciences Bulletin 24(1), 1979), and of the depth below the surrounding
    ground. Places without ground have 0.
    """
    if not (_last and _last[0][0]() is ground):
        _last[:] = [(ref(ground), _moisture(ground))]
    return _last[0][1]


def _moisture(ground: Ground) -> FloatArray:
    x0, y0, x1, y1 = ground.extent_m
    spacing_m = max(x1 - x0, y1 - y0) / CELLS
    index = (np.arange(CELLS) + 0.5) / CELLS
    x, y = np.meshgrid(x0 + (x1 - x0) * index, y0 + (y1 - y0) * index)
    height_m = ground.height_at(np.column_stack((x.ravel(), y.ravel()))).reshape(x.shape)
    is_ground = np.isfinite(height_m)
    if not is_ground.any() or np.ptp(height_m[is_ground]) == 0:
        return np.where(is_ground, 0.5, 0.0)
    height_m = np.where(is_ground, height_m, height_m[is_ground].max())
    # Roughness finer than a few cells holds no water.
    height_m = scipy.ndimage.gaussian_filter(height_m, 2.0, mode="nearest")
    rng = np.random.default_rng(0)
    area = np.zeros(height_m.size)
    for _ in range(ROUNDS):
        area += drainage_area(receivers(height_m, spacing_m, rng)) / ROUNDS
    slope_y, slope_x = np.gradient(height_m, spacing_m)
    slope = np.maximum(np.hypot(slope_x, slope_y), MIN_SLOPE)
    wetness = np.log(area.reshape(height_m.shape) / slope)
    wetness = scipy.ndimage.gaussian_filter(wetness, 1.5, mode="nearest")
    around_m = scipy.ndimage.gaussian_filter(height_m, CELLS * AROUND, mode="nearest")
    wet, low = ranks(wetness, is_ground), ranks(around_m - height_m, is_ground)
    return ranks(WETNESS * wet + (1 - WETNESS) * low, is_ground)
