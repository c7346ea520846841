"""Leaves and needles of woody plants, whose sizes are their own, in bounded numbers.

A tree of 8 m has millions of needles. If there are too many for single triangles, some are drawn
one by one, and shoots of several centimetres with teeth as long as needles stand for the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import ConfigDict

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.plants.growth import Stems, departures, spread_shares, unit
from oaisys_core.procedural.scatter.plants.organ_sizes import STRICT, OrganSize, inner
from oaisys_core.procedural.scatter.plants.organs import (
    FORK_TRIANGLES,
    SHOOT_TRIANGLES,
    SPREAD,
    Organs,
    add_forks,
    add_leaves,
    add_needles,
    add_shoots,
    add_simple_leaves,
    shades,
)
from oaisys_core.types import FloatArray

Color = tuple[float, float, float]

LEAF_TRIANGLES, SIMPLE_TRIANGLES = 4, 2

NEEDLE_SHARE, FORK_SHARE = 0.1, 0.45
"""Shares of the triangles that needles and forks have where shoots stand for most needles."""

NEEDLE_PITCH = 2.4
"""Distance of the needles of a row along its shoot, in their width. They lean against it, so that
across them it is some twice their width, and gaps are as wide as they are."""

TWIG_LEAVES = 8
"""Organs on each of the outermost twigs, which are triangles."""

CANDIDATES = 2.2
"""Places that are tried for each organ; stems of more than this times the mean length have no more
organs than those."""

SHORTEST_TWIG = 0.25
"""Length of twigs on the shortest stems, relative to others: without this, tops would be blunt."""

NEAR_GROUND = 0.1
"""Height, as a share of the plant's size, below which organs point upwards."""

TWIG_WIDTH = 0.012
"""Width of such a twig as a share of its length."""


@dataclass(frozen=True)
class Foliage:
    """Leaves or needles on the stems of the highest order.

    Attributes:
        cover: Their area on a plant of 1 m, in m²; it grows with the square of the plant's size
            as far as the number of triangles allows.
        colors: Of young and of old ones, or of shade and light.
        angle_deg: From the stem, at its foot and at its tip.
        span: Shares of the stem's length on which they grow.
        twig: Length of the outermost twigs as a share of the plant's size, without which leaves
            of large trees would cling to the branches; only as long as two leaves or longer.
        shoot_m: (least, largest) length of shoots with needles; None of leaves.
        slim: Whether the needles of shoots are drawn apart; otherwise the shoots are dense, and
            some of them pairs of triangles.
        droop: See `add_leaves`.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    cover: float
    colors: tuple[Color, Color]
    angle_deg: tuple[float, float] = (70.0, 35.0)
    span: tuple[float, float] = (0.1, 1.0)
    twig: float = 0.0
    shoot_m: tuple[float, float] | None = None
    slim: bool = False
    droop: float = 0.25


@dataclass(frozen=True)
class Dress:
    """What dresses a plant.

    Attributes:
        parts: Where organs are added, in units of the plant's size.
        orders: Stems with their shares of the organs.
        foliage, organ: What grows, and its size.
        bark: Colour of twigs.
        size_m: Of the plant.
    """

    parts: MeshBuilder
    orders: list[tuple[Stems, float]]
    foliage: Foliage
    organ: OrganSize
    bark: Color
    size_m: float

    def dress(self, most_triangles: int, rng: np.random.Generator) -> None:
        """Add leaves or needles to stems; outer and upper ones are brighter."""
        area_m2 = self.foliage.cover * self.size_m**2
        wanted = area_m2 / self.organ.area_m2
        most = most_triangles * TWIG_LEAVES // (TWIG_LEAVES + 1)
        if self.foliage.shoot_m is None:
            self._leaves(wanted, most, rng)
        elif wanted <= most:
            self._needles(round(wanted), rng)
        else:
            self._shoots(area_m2, most, self.foliage.shoot_m, rng)

    def _leaves(self, wanted: float, most: int, rng: np.random.Generator) -> None:
        """Add leaves, as many of them folded ones of four triangles as there may be."""
        feet, directions, colors = self._places(min(wanted, most / SIMPLE_TRIANGLES), rng)
        count = len(feet)
        leaves = (feet, directions, *self.organ.draw(count, rng, self.size_m), colors)
        spare = max(most - count * SIMPLE_TRIANGLES, 0)
        folded = rng.permutation(count) < spare // (LEAF_TRIANGLES - SIMPLE_TRIANGLES)
        for chosen, add in ((folded, add_leaves), (~folded, add_simple_leaves)):
            some = Organs(*(each[chosen] for each in leaves))
            add(self.parts, some, rng, droop=self.foliage.droop)

    def _needles(self, count: int, rng: np.random.Generator) -> None:
        feet, directions, colors = self._places(count, rng)
        sizes = self.organ.draw(len(feet), rng, self.size_m)
        add_needles(self.parts, Organs(feet, directions, *sizes, colors), rng)

    def _shoots(
        self, area_m2: float, most: int, limits_m: tuple[float, float], rng: np.random.Generator
    ) -> None:
        """Add some needles, and shoots as long and as many as the area asks for."""
        needles = round(NEEDLE_SHARE * most)
        self._needles(needles, rng)
        forks = 0 if self.foliage.slim else round(FORK_SHARE * most / FORK_TRIANGLES)
        shoots = (most - needles - forks * FORK_TRIANGLES) // SHOOT_TRIANGLES
        tooth_m = SPREAD * sum(inner(self.organ.length_m)) / 2
        # Slim teeth have two thirds of the area of others, and a fork twice that of a shoot.
        width_m = tooth_m * (shoots * (0.67 if self.foliage.slim else 1.0) + 2 * forks)
        low_m, high_m = inner(limits_m)
        twig_m = self.size_m * float(np.mean(self.orders[0][0].lengths_m))
        longest_m = float(np.clip(0.5 * twig_m, low_m, high_m))
        length_m = float(np.clip(area_m2 / width_m, low_m, longest_m))
        share = min(1.0, area_m2 / (length_m * width_m))
        needle_m = NEEDLE_PITCH * self.organ.mean_width_m / self.size_m
        for number, is_fork in ((shoots, False), (forks, True)):
            feet, directions, colors = self._places(share * number, rng)
            lengths = length_m * rng.uniform(0.75, 1.3, len(feet))
            lengths = np.clip(lengths, low_m, high_m) / self.size_m
            teeth, _ = self.organ.draw(len(feet), rng, self.size_m)
            if is_fork:
                organs = Organs(feet, directions, lengths, 2 * SPREAD * teeth, colors)
                add_forks(self.parts, organs, rng, needle_m)
            else:
                organs = Organs(feet, directions, lengths, teeth, colors)
                add_shoots(self.parts, organs, rng, needle_m, slim=self.foliage.slim)

    def _places(
        self, wanted: float, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return feet, directions and colours, (N, 3) each, of about so many organs."""
        count = max(round(wanted), 3)
        orders = self.orders
        if self.foliage.twig * self.size_m > 2 * self.organ.length_m[1]:
            orders = [(self._twigs(-(-count // TWIG_LEAVES), rng), 1.0)]
        feet, directions, _ = _spread(orders, self.foliage, count, rng)
        # Nothing near the ground grows into it.
        directions[:, 2] = np.where(feet[:, 2] < NEAR_GROUND, np.abs(directions[:, 2]),
                                    directions[:, 2])  # fmt: skip
        colors = shades(rng, *self.foliage.colors, len(feet)) * _light(feet)[:, None]
        return feet, directions, colors

    def _twigs(self, count: int, rng: np.random.Generator) -> Stems:
        """Add twigs of one triangle each and return them."""
        feet, directions, of_stems = _spread(self.orders, self.foliage, count, rng)
        lengths = self.foliage.twig * rng.uniform(0.6, 1.3, len(feet))
        lengths *= np.clip(of_stems, SHORTEST_TWIG, 1.0)
        ends = feet + lengths[:, None] * unit(directions)
        widths = TWIG_WIDTH * lengths
        bark = np.tile(np.asarray(self.bark, np.float64), (len(feet), 1))
        twigs = Organs(feet, directions, lengths, widths, bark)
        add_needles(self.parts, twigs, rng, translucency=0.0)
        return Stems(np.stack((feet, ends), axis=1), np.zeros((len(feet), 2)))


def _spread(
    orders: list[tuple[Stems, float]], foliage: Foliage, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (N, 3) feet and directions of about ``count`` organs, and relative lengths of stems.

    On the stems of each order they are as dense on long ones as on short ones.
    """
    total = sum(share for _, share in orders)
    feet, directions, lengths = [], [], []
    for stem, share in orders:
        number = round(count * share / total)
        relative = stem.lengths_m / stem.lengths_m.mean()
        each = -(-round(CANDIDATES * number) // len(relative))
        shares = spread_shares(len(relative), each, foliage.span, rng)
        some, ways, _ = departures(stem, shares, foliage.angle_deg, 0.2, rng)
        taken = np.flatnonzero(rng.uniform(size=shares.shape) < relative[:, None] / CANDIDATES)
        chosen = np.sort(taken[rng.permutation(len(taken))[:number]])
        feet.append(some.reshape(-1, 3)[chosen])
        directions.append(ways.reshape(-1, 3)[chosen])
        lengths.append(np.repeat(relative, each)[chosen])
    return np.concatenate(feet), np.concatenate(directions), np.concatenate(lengths)


def _light(feet: FloatArray) -> FloatArray:
    """Return (N,) brightness factors: leaves outside and above are paler than those within."""
    centre = feet.mean(axis=0)
    reach = np.maximum(np.ptp(feet, axis=0) / 2, 1e-6)
    away = np.linalg.norm((feet - centre) / reach, axis=1)
    return np.asarray(np.clip(0.72 + 0.3 * np.clip(away, 0, 1.2), 0.7, 1.1))
