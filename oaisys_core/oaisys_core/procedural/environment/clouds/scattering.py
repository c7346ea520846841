"""How clouds scatter light: phase function, many orders of scattering, light from all around.

Orders of scattering are approximated by octaves (Wrenninge, "Art-Directable Multiple Volumetric
Scattering", SIGGRAPH 2015, after Wrenninge, Kulla and Lundqvist, "Oz: The Great and Volumetric",
SIGGRAPH 2013): each has a share of the light of the one before, sees a share of the depth, and
scatters less forwards. With the constants here, a thick cloud that faces the sun reflects 0.71 of
its light, and one with an optical depth of 40 lets 0.15 through; a two-stream model says 0.82 and
0.18 (see `diffuse_share`).
"""

from __future__ import annotations

from math import pi

import numpy as np

from oaisys_core.procedural.terrain.noise import Field

FORWARD, BACKWARD, FORWARD_SHARE = 0.8, -0.25, 0.75
"""Mean cosines of the two lobes of the phase function, and the share of the first: of droplets,
nearly as Mie's theory has it."""

ORDERS, LIGHT, DEPTH, NARROWNESS = 8, 0.85, 0.5, 0.6
"""Number of octaves, and the factors from one to the next: of light, optical depth, mean cosines.
"""

ASYMMETRY = 0.85
"""Mean cosine of light that droplets scatter (Stephens 1978), for light from all directions."""


def phase(cosines: Field, narrowness: float = 1.0) -> Field:
    """Return the share of light, per steradian, that is scattered by an angle.

    Two lobes of Henyey and Greenstein (1941, ApJ 93, 70).

    Args:
        cosines: (...) of the angle between the light's ways before and after; 1 is straight on.
        narrowness: Factor on the mean cosines; 0 scatters the same in all directions.
    """
    ahead = _lobe(cosines, FORWARD * narrowness)
    back = _lobe(cosines, BACKWARD * narrowness)
    return np.asarray(FORWARD_SHARE * ahead + (1 - FORWARD_SHARE) * back, np.float32)


def _lobe(cosines: Field, g: float) -> Field:
    square = np.maximum(1 + g * g - 2 * g * cosines, 1e-6)
    return np.asarray((1 - g * g) / (4 * pi) / (square * np.sqrt(square)), np.float32)


def order_phases(cosines: Field) -> Field:
    """Return the (ORDERS, ...) share of light, per steradian, that each order scatters."""
    shape = np.shape(cosines)
    found = np.empty((ORDERS, *shape), np.float32)
    for order in range(ORDERS):
        found[order] = phase(cosines, NARROWNESS**order) * np.float32(LIGHT**order)
    return found


def in_scattering(depth: Field, phases: Field) -> Field:
    """Return the (N,) radiance per unit of extinction and way, of sunlight of 1 W/m² outside.

    Args:
        depth: (N,) optical depth towards the sun.
        phases: (ORDERS, N) of `order_phases`.
    """
    # The order that light reaches most easily comes first; each other one is a power of it.
    passed = np.exp(depth * np.float32(-(DEPTH ** (ORDERS - 1))))
    total = phases[-1] * passed
    for of_order in phases[-2::-1]:
        # `DEPTH` is a half.
        passed *= passed
        total += of_order * passed
    return np.asarray(total)


def diffuse_share(depth: Field) -> Field:
    """Return the share of light from all directions that reaches an optical depth.

    The two-stream solution without absorption, 1 / (1 + 3 / 4 (1 - g) depth) (Bohren, "Multiple
    scattering of light and some of its observable consequences", American Journal of Physics 55,
    1987, with Eddington's factor).
    """
    return np.asarray(1 / (1 + np.float32(0.75 * (1 - ASYMMETRY)) * depth), np.float32)
