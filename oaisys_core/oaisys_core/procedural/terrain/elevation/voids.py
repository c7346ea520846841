"""Values that mean that a height is missing, whether a file says so or not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray

NO_HEIGHT = 1e30
"""No height is as large, in any unit; limits of 32-bit floats, which files use for voids, are."""

COMMON_VOIDS = (-32768.0, -32767.0, -9999.0, 32767.0, 65535.0, -99999.0, -999999.0, -999.0)
"""Values that programs write for missing heights."""

WIDTHS = 3.0
"""A common void stands far from the rest if it lies this many times the width of the rest away.

The rest are the middle 90 % of the other heights: voids that an interpolation smeared are few.
"""

JUMP_M = 1000.0
"""Any other value stands far from the rest beyond a gap of this much that is also wider than the
rest as a whole, because real slopes have heights in between."""

Voids = float | Sequence[float] | Literal["none"] | None
"""Values of voids in a configuration: in addition to those that the file states; ``none``: every
other value is a height; None: none, but values that look like voids are an error."""


def find_missing(values: FloatArray, stated: Voids) -> NDArray[np.bool_]:
    """Return which stored values are no heights.

    Args:
        values: (rows, cols) as stored; NaN where the file says that nothing was measured.
        stated: Of the configuration.
    """
    missing = ~(np.abs(values) < NO_HEIGHT)
    if stated is not None and stated != "none":
        for void in np.atleast_1d(np.asarray(stated, np.float64)):
            # A file may store what a person writes as a float of 32 bits.
            missing |= np.isclose(values, void, rtol=1e-6, atol=0)
    return missing


def check_for_voids(heights: FloatArray, factor_m: float, field: str) -> None:
    """Raise `InvalidInputError` if some values look like voids.

    Args:
        heights: (n,) stored values that neither the file nor the configuration calls voids.
        factor_m: Metres per stored unit.
        field: Name of the configuration field in errors.
    """
    suspect = _suspect(heights, factor_m)
    if suspect is not None:
        found = f"{int((heights == suspect).sum())} pixels of {suspect:.9g} far from all others"
        expected = (
            f"heights near the others. If these are voids, set {field}.nodata: {suspect:.9g};"
            f" if they are heights, {field}.nodata: none"
        )
        raise InvalidInputError(f"{field}.nodata", found, expected)


def _suspect(values: FloatArray, factor_m: float) -> float | None:
    """Return a value that stands far from the others."""
    if values.size < 2:
        return None
    low, high = float(values.min()), float(values.max())
    inside = [void for void in COMMON_VOIDS if low <= void <= high]
    for void in (*inside, low, high):
        is_rest = values != void
        if is_rest.any() and not is_rest.all() and _is_far(void, values[is_rest], factor_m):
            return void
    return None


def _is_far(value: float, rest: FloatArray, factor_m: float) -> bool:
    if value in COMMON_VOIDS:
        first, last = np.quantile(rest, (0.05, 0.95))
        return bool(max(first - value, value - last) > WIDTHS * (last - first))
    gap = max(rest.min() - value, value - rest.max())
    return bool(gap * abs(factor_m) > max(JUMP_M, np.ptp(rest) * abs(factor_m)))
