"""Ripples on water, which Cycles' shader nodes and `draft` share."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import spectral
from oaisys_core.types import FloatArray

RIPPLES_PX, RIPPLE_TILES_M = 256, (1.7, 7.3)
"""Size of the image of ripples, and the edges of its tiles: two copies hide the repetition."""

MAX_SLOPE = 0.16
"""Standard deviation of the slope at the strongest ripples: sqrt(0.003 + 0.00512 v) for a wind of
v = 4.5 m/s (Cox and Munk 1954)."""

RIPPLES_TO_M = 8.0
"""Distance from which ripples are fainter, in inverse proportion."""


@cache
def ripple_slopes() -> NDArray[np.float32]:
    """Return (N, N, 2) slopes along x and y with standard deviation 1."""
    height = spectral(RIPPLES_PX, 6, np.random.default_rng(0), 2.2)
    slopes = np.zeros((RIPPLES_PX, RIPPLES_PX, 2), np.float32)
    for channel, axis in enumerate((1, 0)):
        change: FloatArray = np.roll(height, -1, axis) - np.roll(height, 1, axis)
        slopes[..., channel] = change / change.std()
    return slopes
