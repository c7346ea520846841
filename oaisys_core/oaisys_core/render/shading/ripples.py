"""Ripples on water, which Cycles' shader nodes and `draft` share."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import spectral
from oaisys_core.types import FloatArray

Floats = NDArray[np.float32]

RIPPLES_PX, RIPPLE_TILES_M = 256, (1.7, 7.3)
"""Size of the image of ripples, and the edges of its tiles: two copies hide the repetition."""

MAX_SLOPE = 0.16
"""Standard deviation of the slope along one axis at the strongest ripples: that of both axes
together is sqrt(0.003 + 0.00512 v), here for a wind of v = 9.4 m/s (Cox and Munk 1954)."""

RIPPLES_TO_M = 8.0
"""Distance from which ripples are fainter, in inverse proportion."""

FINEST_ALPHA = 0.0036
"""Width of reflections, as Beckmann's alpha, by ripples finer than the image of them."""


@cache
def ripple_slopes() -> NDArray[np.float32]:
    """Return (N, N, 2) slopes along x and y with standard deviation 1."""
    height = spectral(RIPPLES_PX, 6, np.random.default_rng(0), 2.2)
    slopes = np.zeros((RIPPLES_PX, RIPPLES_PX, 2), np.float32)
    for channel, axis in enumerate((1, 0)):
        change: FloatArray = np.roll(height, -1, axis) - np.roll(height, 1, axis)
        slopes[..., channel] = change / change.std()
    return slopes


def share_shown(distance_m: Floats) -> Floats:
    """Return the (N,) share of their slope with which ripples are drawn at (N,) distances."""
    return np.asarray(np.minimum(RIPPLES_TO_M / np.maximum(distance_m, 1e-3), 1))


def variance_not_shown(distance_m: Floats, deviation: Floats) -> Floats:
    """Return the (N,) variance, along one axis, of slopes that a picture of water does not show.

    Ripples are drawn fainter with the distance; those that are not drawn spread reflections.

    Args:
        distance_m: (N,) distances from the camera.
        deviation: (N,) standard deviations of the slope along one axis close to the camera.
    """
    return np.asarray(deviation**2 * (1 - share_shown(distance_m) ** 2), np.float32)


def slope_towards_eye(variance: Floats, tangent: Floats) -> Floats:
    """Return the (N,) mean slope, towards the eye, of the ripples that it sees.

    A facet of slope s counts by the area that it shows, max(0, 1 + s t), t being the tangent of
    the ray's angle to the vertical. For normally distributed slopes (Cox and Munk 1954) the mean
    is variance * t from above and sqrt(pi / 2) deviations at the horizon; in between, this is
    within a tenth of a deviation of it.

    Args:
        variance: (N,) variances of the slope along one axis.
        tangent: (N,) tangents.
    """
    steepness = variance * tangent**2
    return np.asarray(variance * tangent / np.sqrt(1 + steepness * (2 / np.pi)), np.float32)
