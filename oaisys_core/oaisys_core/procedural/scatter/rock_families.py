"""Where kinds of rock prefer to lie: angular ones near scarps, rounded ones where water runs."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.scatter.density import Density, bilinear
from oaisys_core.procedural.scatter.placement import slope_deg
from oaisys_core.procedural.terrain.moisture import moisture
from oaisys_core.procedural.terrain.noise import Field
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

MIN_DENSITY = 0.3
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
    """Return (CELLS, CELLS) nearness to steep ground, 0 to 1, row 0 at the smallest y."""
    import cv2

    x0, y0, x1, y1 = ground.extent_m
    index = (np.arange(CELLS) + 0.5) / CELLS
    x, y = np.meshgrid(x0 + (x1 - x0) * index, y0 + (y1 - y0) * index)
    low, high = SCARP_DEG
    slope = slope_deg(ground, np.column_stack((x.ravel(), y.ravel()))).reshape(x.shape)
    # At the rim, the slope is not known.
    slope[slope == 90.0] = 0.0
    steep = np.clip((slope - low) / (high - low), 0, 1).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(steep, (0, 0), REACH * CELLS / 2))
