"""Functions with the same bits in all versions of the libraries, for processes that amplify them.

A difference in the last bit of a slope turns water to another side. Sums, products, quotients and
square roots are exact by IEEE 754; other functions are rounded here to digits that all agree on.
"""

from __future__ import annotations

from math import cos, exp, pi, radians, sin, tan

import numpy as np
import scipy

from oaisys_core.types import FloatArray

DIGITS = 10


def tangent(angle_deg: float) -> float:
    """Return the tangent of an angle."""
    return round(tan(radians(angle_deg)), DIGITS)


def draw_direction(rng: np.random.Generator) -> tuple[float, float]:
    """Return the (x, y) of a unit vector of a drawn direction."""
    heading = rng.uniform(0, 2 * pi)
    return round(cos(heading), DIGITS), round(sin(heading), DIGITS)


def smooth(values: FloatArray, cells: float, truncate: float = 4.0) -> FloatArray:
    """Return (rows, cols) values under a Gaussian; those of the edges go on beyond them.

    Args:
        values: What is smoothed.
        cells: Standard deviation of the Gaussian.
        truncate: Where the Gaussian ends, in standard deviations.
    """
    reach = int(truncate * cells + 0.5)
    weights = np.array(
        [round(exp(-0.5 * (k / cells) ** 2), DIGITS) for k in range(-reach, reach + 1)]
    )
    weights /= sum(weights.tolist())
    for axis in (0, 1):
        values = scipy.ndimage.correlate1d(values, weights, axis, np.float64, mode="nearest")
    return values
