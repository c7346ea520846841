"""How large the things on a tile are: laws of sizes, and draws from them."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from oaisys_core.types import FloatArray

BINS = 64


class SizeLaw(Protocol):
    """A law of diameters."""

    def cover_above(self, diameter: FloatArray) -> FloatArray:
        """Return the area that things larger than a diameter cover, up to a constant factor."""


class RosinRammler(NamedTuple):
    """The law of what was broken: exp(-(D / scale)**exponent) of the volume is larger than D.

    P. Rosin and E. Rammler, "The laws governing the fineness of powdered coal", J. Inst. Fuel 7,
    1933. In a section the area has the same share as the volume (Delesse, 1847). With an exponent
    of 1 it is the law by which M. Golombek and D. Rapp ("Size-frequency distributions of rocks on
    Mars", JGR 102, 1997, eq. 1) describe the area that rocks cover at the Viking landing sites.

    Attributes:
        scale: Diameter in any unit.
        exponent: 1 for fragments; larger for sorted stones.
    """

    scale: float
    exponent: float = 1.0

    def cover_above(self, diameter: FloatArray) -> FloatArray:
        """See `SizeLaw`."""
        return np.asarray(np.exp(-((diameter / self.scale) ** self.exponent)))


class PowerLaw(NamedTuple):
    """The law of fragments of impacts: the number larger than D goes as D**-exponent.

    E. Shoemaker and E. Morris, "Geology: physics of fragmental debris", Icarus 12, 1970: exponents
    from 1.8 (near large craters) to 2.6 at the landing sites of Surveyor on the Moon.
    """

    exponent: float

    def cover_above(self, diameter: FloatArray) -> FloatArray:
        """See `SizeLaw`."""
        power = 2 - self.exponent
        if abs(power) < 1e-9:
            return np.asarray(-np.log(diameter))
        return np.asarray(-(diameter**power) / power)


def draw_diameters(
    law: SizeLaw, cover: float, limits: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return diameters of discs that together have a share of a tile's area, the largest first.

    Args:
        law: Their law.
        cover: Sum of their areas.
        limits: Least and largest diameter, in tile edges.
        rng: Draws them.
    """
    edges = np.geomspace(*limits, BINS + 1)
    share = -np.diff(law.cover_above(edges))
    middle = np.sqrt(edges[1:] * edges[:-1])
    numbers = cover * share / share.sum() / (np.pi / 4 * middle**2)
    until = np.concatenate(([0.0], np.cumsum(numbers)))
    drawn = rng.uniform(0, until[-1], round(until[-1]))
    diameters = np.exp(np.interp(drawn, until, np.log(edges)))
    # Versions of NumPy differ in the last digits of exponents.
    return np.sort(diameters.astype(np.float32).astype(np.float64))[::-1]
