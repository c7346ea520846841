"""Where kinds of rock prefer to lie: angular ones below scarps, rounded ones where water runs."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.scatter.placement.density import Density, bilinear
from oaisys_core.procedural.scatter.placement.random_poses import slope_deg
from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.terrain.water.moisture import moisture
from oaisys_core.scene import Ground
from oaisys_core.types import FloatArray

ROUNDED = frozenset({"rounded", "pebble"})
"""Kinds that water has worn; all others broke off steep ground."""

FRAGMENTS = 0.5
"""Share of broken rocks that lie beside a larger one; water takes those of rounded rocks away."""

CELLS = 128
"""Cells along an edge of the ground at which scarps are looked for."""

SCARP_DEG = (22.0, 38.0)
"""Slopes from which ground begins to be a scarp, and from which it is one."""

REACH = 0.06
"""How far rocks roll from a scarp, as a share of the stage's edge."""

SHADOW = float(np.tan(np.radians(27.5)))
"""Tangent of the least angle at which one sees a scarp from where its rocks come to rest (Evans and
Hungr, "The assessment of rockfall hazard at the base of talus slopes", Canadian Geotechnical
Journal 30(4), 1993)."""

ROLLS = 24
"""Farthest cells to which rocks roll from a scarp."""

CROWDED_M = 4.0
"""How far below the farthest place to which they roll rocks lie half as densely as they may."""

ASTRIDE = 0.5
"""How much a place beside a scarp, on either side, is liked, relative to one below it."""

MIN_DENSITY = 0.15
"""Density of the least liked places, relative to the most liked ones."""


def fragment_share(kind: str) -> float:
    """Return the share of rocks of a kind that lie beside a larger one, as its fragments."""
    return 0.0 if kind in ROUNDED else FRAGMENTS


def family_density(kind: str, ground: Ground) -> Density:
    """Return how likely a kind of rock lies at points of a ground, 0 to 1."""
    if kind in ROUNDED:
        liked = moisture(ground) ** 2
    else:
        liked = _near_scarps(ground)
        highest = liked.max()
        # Without scarps, they lie anywhere.
        liked = liked / highest if highest > MIN_DENSITY else np.ones_like(liked)

    def density(xy: FloatArray) -> FloatArray:
        return np.asarray(MIN_DENSITY + (1 - MIN_DENSITY) * bilinear(liked, ground, xy))

    return density


def _near_scarps(ground: Ground) -> Field:
    """Return (CELLS, CELLS) shares, 0 to 1, of rock that falls from steep ground and lies here.

    Row 0 is at the smallest y.
    """
    import cv2

    x0, y0, x1, y1 = ground.extent_m
    index = (np.arange(CELLS) + 0.5) / CELLS
    x, y = np.meshgrid(x0 + (x1 - x0) * index, y0 + (y1 - y0) * index)
    places = np.column_stack((x.ravel(), y.ravel()))
    low, high = SCARP_DEG
    slope = slope_deg(ground, places).reshape(x.shape)
    # At the rim, the slope is not known.
    slope[slope == 90.0] = 0.0
    steep = np.clip((slope - low) / (high - low), 0, 1).astype(np.float32)
    beside = cv2.GaussianBlur(steep, (0, 0), REACH * CELLS / 2)
    height_m = ground.height_at(places).reshape(x.shape)
    below = _below_scarps(height_m, slope >= high, max(x1 - x0, y1 - y0) / CELLS)
    return np.asarray(ASTRIDE * beside + (1 - ASTRIDE) * below, np.float32)


def _below_scarps(height_m: FloatArray, is_scarp: NDArray[np.bool_], cell_m: float) -> Field:
    """Return how densely rocks lie below scarps, 0 to 1, from (rows, cols) heights."""
    is_scarp = is_scarp & np.isfinite(height_m)
    if not is_scarp.any():
        return np.zeros(height_m.shape, np.float32)
    lowest_m = float(np.nanmin(height_m))
    sources_m = np.where(is_scarp, height_m, lowest_m)
    steps = np.arange(-ROLLS, ROLLS + 1)
    away_m = cell_m * np.hypot(steps[:, None], steps)
    cone_m = scipy.ndimage.grey_dilation(sources_m, structure=-SHADOW * away_m, mode="nearest")
    under_m = np.maximum(cone_m - np.nan_to_num(height_m, nan=np.inf), 0.0)
    below = np.where(is_scarp, 0.0, under_m / (under_m + CROWDED_M))
    return np.asarray(scipy.ndimage.gaussian_filter(below, 1.0, mode="nearest"), np.float32)
