"""Shrubs and small trees: stems in several orders with leaves or needles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import ConfigDict

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.plants.fitting import fit_to_size
from oaisys_core.procedural.scatter.plants.foliage import Color, Dress, Foliage
from oaisys_core.procedural.scatter.plants.growth import UP, StemRule, Stems, branches, stems
from oaisys_core.procedural.scatter.plants.organ_sizes import ORGANS, STRICT, OrganSize
from oaisys_core.procedural.scatter.plants.organs import add_stems
from oaisys_core.scene import MeshPrototype

FLOWER_SHARE = 0.25
"""Largest share of the triangles that flowers have."""


@dataclass(frozen=True)
class WoodyPlant:
    """A species with one or more trunks, as ``plants.yaml`` describes it.

    Attributes:
        trunks: Number of trunks.
        lean: How far trunks lean outwards.
        height: Of the trunks, before the plant is scaled to 1 m.
        radius: Of a trunk at its foot.
        trunk: How trunks grow.
        orders: Rules of the branches, from the lowest order.
        bark: Colours of the trunk and of the outermost twigs.
        foliage: Leaves or needles.
        inner: Share of the foliage's number that the stems of the last order but one have, too.
        flowers: A second kind of foliage, such as blossoms.
        most_triangles: Largest number of triangles, at any size.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT

    trunks: int
    lean: float
    height: float
    radius: float
    trunk: StemRule
    orders: tuple[StemRule, ...]
    bark: tuple[Color, Color]
    foliage: Foliage
    inner: float = 0.0
    flowers: Foliage | None = None
    most_triangles: int = 30_000

    def grow(self, name: str, rng: np.random.Generator, size_m: float = 1.0) -> MeshPrototype:
        """Return a plant for a size, scaled to 1 m along its longest axis."""
        organs = ORGANS[name]
        return fit_to_size(
            name, lambda rng, unit_m, _: self._build(organs, rng, unit_m), rng, size_m
        )

    def _build(
        self, organs: Mapping[str, OrganSize], rng: np.random.Generator, unit_m: float
    ) -> MeshBuilder:
        parts = MeshBuilder()
        orders = self._orders(rng)
        points = np.concatenate([each.points_m.reshape(-1, 3) for each in orders])
        shrink = 1 / np.ptp(points, axis=0).max()
        orders = [Stems(shrink * each.points_m, shrink * each.radii_m) for each in orders]
        for level, stem in enumerate(orders):
            share = level / max(len(orders) - 1, 1)
            color = np.asarray(self.bark[0]) * (1 - share) + np.asarray(self.bark[1]) * share
            bright = rng.uniform(0.8, 1.15, (len(stem.points_m), 1))
            add_stems(parts, stem, bright * color, sides=5 if level == 0 else 3)
        outer, inner = orders[-1], orders[-2]
        inner_share = self.inner * len(inner.points_m) / len(outer.points_m)
        left = self.most_triangles - parts.triangle_count
        flowers = round(FLOWER_SHARE * left) if self.flowers is not None else 0
        where = [(outer, 1.0), (inner, inner_share)]
        bark = self.bark[1]
        dress = Dress(parts, where, self.foliage, organs["leaf"], bark, unit_m)
        dress.dress(left - flowers, rng)
        if self.flowers is not None:
            dress = Dress(parts, [(outer, 1.0)], self.flowers, organs["flower"], bark, unit_m)
            dress.dress(flowers, rng)
        return parts

    def _orders(self, rng: np.random.Generator) -> list[Stems]:
        """Return the trunks and the branches of each order, from the lowest."""
        orders = [self._trunks(rng)]
        for rule in self.orders:
            orders.append(branches(orders[-1], rule, rng))
        return orders

    def _trunks(self, rng: np.random.Generator) -> Stems:
        count = self.trunks
        around = rng.uniform(0, 2 * np.pi) + 2.4 * np.arange(count) + rng.normal(0, 0.2, count)
        out = np.column_stack((np.cos(around), np.sin(around), np.zeros(count)))
        # Inner trunks stand upright.
        lean = self.lean * np.sqrt((np.arange(count) + 0.5) / count)[:, None]
        feet = 1.2 * self.radius * np.sqrt(count - 1) * out * lean / max(self.lean, 1e-6)
        heights = self.height * rng.uniform(0.85, 1.1, count)
        # The foot is below the ground, so that no gap shows on slopes.
        return stems(feet - 0.03 * UP, UP + lean * out, heights, np.full(count, self.radius),
                     self.trunk, rng)  # fmt: skip
