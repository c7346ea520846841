"""Functions with the same bits in all versions of the libraries, for processes that amplify them.

A difference in the last bit of a slope turns water to another side. Sums, products, quotients and
square roots are exact by IEEE 754; other functions are rounded here to digits that all agree on.
"""

from __future__ import annotations

from math import cos, pi, radians, sin, tan

import numpy as np

DIGITS = 10


def tangent(angle_deg: float) -> float:
    """Return the tangent of an angle."""
    return round(tan(radians(angle_deg)), DIGITS)


def draw_direction(rng: np.random.Generator) -> tuple[float, float]:
    """Return the (x, y) of a unit vector of a drawn direction."""
    heading = rng.uniform(0, 2 * pi)
    return round(cos(heading), DIGITS), round(sin(heading), DIGITS)
