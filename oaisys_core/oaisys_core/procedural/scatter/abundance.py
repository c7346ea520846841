"""How many rocks of which size lie on a plain, by the share of the ground that they cover.

Golombek and Rapp, "Size-frequency distributions of rocks on Mars and Earth analog sites:
Implications for future landed missions", JGR 102(E2), 1997: rocks wider than D cover the share
k exp(-q D) of the ground, with q = 1.79 + 0.152 / k per metre.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from oaisys_core.types import FloatArray

STEPS = 512
"""Sizes between which numbers of rocks are summed up."""

DIGITS = 6
"""Decimal digits of sizes in metres: exponentials differ in their last bits."""


class RockAbundance(NamedTuple):
    """Rocks of a range of sizes on a square metre.

    Attributes:
        sizes_m: (`STEPS`,) increasing sizes.
        below: (`STEPS`,) numbers of rocks per m² from the smallest size up to each.
    """

    sizes_m: FloatArray
    below: FloatArray

    @property
    def per_m2(self) -> float:
        """Number of rocks per m²."""
        return float(self.below[-1])

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count,) sizes in metres."""
        place = rng.uniform(size=count) * self.below[-1]
        return np.asarray(np.round(np.interp(place, self.below, self.sizes_m), DIGITS))


def rock_abundance(cover: float, size_m: tuple[float, float]) -> RockAbundance:
    """Return the rocks of a range of sizes where rocks of all sizes cover a share of the ground.

    Args:
        cover: The share k, above 0: 0.01 to 0.4 at landing sites on Mars.
        size_m: Least and largest size, taken as the rocks' mean width.
    """
    q = 1.79 + 0.152 / cover
    sizes_m = np.geomspace(*size_m, STEPS)
    # The number of rocks is the covered area over that of a disc.
    density = cover * q * np.exp(-q * sizes_m) / (pi / 4 * sizes_m**2)
    steps = np.diff(sizes_m) * (density[1:] + density[:-1]) / 2
    return RockAbundance(sizes_m, np.concatenate(([0.0], np.cumsum(steps))))
