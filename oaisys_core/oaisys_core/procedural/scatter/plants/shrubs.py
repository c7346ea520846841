"""Shrubs and small trees: stems in several orders with leaves or needles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.plants.fitting import fitted
from oaisys_core.procedural.scatter.plants.foliage import Color, Dress, Foliage
from oaisys_core.procedural.scatter.plants.growth import UP, StemRule, Stems, branches, stems
from oaisys_core.procedural.scatter.plants.organ_sizes import ORGANS, OrganSize
from oaisys_core.procedural.scatter.plants.organs import add_stems
from oaisys_core.scene import MeshPrototype

TREE_TRIANGLES, SHRUB_TRIANGLES = 60_000, 30_000
"""Largest numbers of triangles of a plant, at any size."""

FLOWER_SHARE = 0.25
"""Largest share of the triangles that flowers have."""


@dataclass(frozen=True)
class WoodyPlant:
    """A species with one or more trunks.

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
    most_triangles: int = SHRUB_TRIANGLES

    def grow(self, name: str, rng: np.random.Generator, size_m: float = 1.0) -> MeshPrototype:
        """Return a plant for a size, scaled to 1 m along its longest axis."""
        organs = ORGANS[name]
        return fitted(name, lambda rng, unit_m, _: self._build(organs, rng, unit_m), rng, size_m)

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


HEATHER = WoodyPlant(
    trunks=34,
    lean=0.8,
    height=0.42,
    radius=0.007,
    trunk=StemRule(1, bend=0.55, wander=0.25, points=5, taper=0.5),
    orders=(
        StemRule(
            6, (0.3, 1.0), 0.55, (1.0, 0.9, 0.6), (38.0, 22.0), 0.6, 0.15, points=3, thickness=0.5
        ),
    ),
    bark=((0.27, 0.21, 0.16), (0.30, 0.27, 0.14)),
    foliage=Foliage(1.4, ((0.22, 0.27, 0.11), (0.34, 0.36, 0.17)), shoot_m=(0.02, 0.06)),
    inner=0.6,
    flowers=Foliage(
        0.40, ((0.58, 0.30, 0.50), (0.74, 0.52, 0.66)), (75.0, 50.0), (0.45, 1.0),
        shoot_m=(0.02, 0.06),
    ),
)  # fmt: skip

JUNIPER = WoodyPlant(
    trunks=9,
    lean=1.3,
    height=0.6,
    radius=0.012,
    trunk=StemRule(1, bend=0.5, wander=0.3, points=6),
    orders=(
        StemRule(9, (0.12, 1.0), 0.5, (0.9, 1.0, 0.5), (55.0, 30.0), 0.35, 0.2, points=4),
        StemRule(7, (0.1, 1.0), 0.42, (0.8, 1.0, 0.6), (48.0, 30.0), 0.2, 0.15, points=3),
    ),
    bark=((0.30, 0.22, 0.16), (0.34, 0.28, 0.18)),
    foliage=Foliage(
        1.6, ((0.16, 0.25, 0.15), (0.33, 0.42, 0.28)), (60.0, 30.0), shoot_m=(0.03, 0.10), twig=0.03
    ),
    inner=1.0,
)

WILLOW = WoodyPlant(
    trunks=7,
    lean=0.5,
    height=0.75,
    radius=0.016,
    trunk=StemRule(1, bend=0.1, wander=0.25, points=6),
    orders=(
        StemRule(9, (0.2, 1.0), 0.5, (1.0, 0.9, 0.5), (42.0, 22.0), 0.35, 0.2, points=4),
        StemRule(5, (0.2, 1.0), 0.5, (1.0, 0.9, 0.6), (40.0, 25.0), 0.1, 0.15, points=3),
    ),
    bark=((0.36, 0.31, 0.23), (0.47, 0.36, 0.20)),
    foliage=Foliage(
        1.0, ((0.28, 0.37, 0.19), (0.46, 0.52, 0.34)), (50.0, 28.0), droop=0.3, twig=0.066
    ),
    inner=0.5,
)

BIRCH = WoodyPlant(
    most_triangles=TREE_TRIANGLES,
    trunks=1,
    lean=0.08,
    height=1.0,
    radius=0.017,
    trunk=StemRule(1, bend=0.1, wander=0.14, points=9, taper=0.12),
    orders=(
        StemRule(
            26, (0.2, 0.97), 0.42, (1.0, 0.85, 0.3), (52.0, 32.0), 0.1, 0.2, points=5,
            thickness=0.5,
        ),
        StemRule(8, (0.22, 1.0), 0.46, (0.8, 1.0, 0.6), (45.0, 30.0), -0.55, 0.2, points=4),
    ),
    bark=((0.72, 0.70, 0.66), (0.28, 0.19, 0.15)),
    foliage=Foliage(0.95, ((0.25, 0.38, 0.10), (0.45, 0.54, 0.17)), (75.0, 50.0), twig=0.045),
    inner=0.8,
)  # fmt: skip

OAK = WoodyPlant(
    most_triangles=TREE_TRIANGLES,
    trunks=1,
    lean=0.1,
    height=0.8,
    radius=0.032,
    trunk=StemRule(1, bend=0.0, wander=0.32, points=7, taper=0.25),
    orders=(
        StemRule(
            13, (0.26, 1.0), 0.58, (1.0, 1.0, 0.55), (68.0, 30.0), 0.4, 0.35, points=5,
            thickness=0.6,
        ),
        StemRule(7, (0.25, 1.0), 0.46, (0.8, 1.0, 0.8), (52.0, 35.0), 0.25, 0.3, points=4),
        StemRule(4, (0.25, 1.0), 0.5, (0.9, 1.0, 0.8), (50.0, 35.0), 0.1, 0.3, points=3),
    ),
    bark=((0.27, 0.23, 0.19), (0.33, 0.27, 0.18)),
    foliage=Foliage(2.3, ((0.20, 0.31, 0.09), (0.36, 0.45, 0.15)), (65.0, 40.0), twig=0.055),
    inner=0.9,
)  # fmt: skip

HAWTHORN = WoodyPlant(
    trunks=4,
    lean=0.55,
    height=0.62,
    radius=0.024,
    trunk=StemRule(1, bend=0.0, wander=0.3, points=6),
    orders=(
        StemRule(9, (0.15, 1.0), 0.55, (1.0, 1.0, 0.6), (60.0, 35.0), 0.25, 0.35, points=4),
        StemRule(7, (0.2, 1.0), 0.42, (0.9, 1.0, 0.7), (55.0, 40.0), 0.1, 0.3, points=3),
    ),
    bark=((0.31, 0.27, 0.22), (0.36, 0.28, 0.20)),
    foliage=Foliage(1.0, ((0.17, 0.29, 0.08), (0.34, 0.44, 0.14)), (70.0, 45.0), twig=0.05),
    inner=0.6,
    flowers=Foliage(0.10, ((0.88, 0.87, 0.80), (0.86, 0.78, 0.76)), (70.0, 45.0), (0.4, 1.0)),
)

SPRUCE = WoodyPlant(
    most_triangles=TREE_TRIANGLES,
    trunks=1,
    lean=0.02,
    height=1.0,
    radius=0.020,
    trunk=StemRule(1, bend=0.05, wander=0.03, points=8, taper=0.08),
    orders=(
        StemRule(
            64, (0.04, 0.99), 0.30, (1.0, 0.62, 0.06), (100.0, 50.0), 0.35, 0.06, points=4,
            thickness=0.22,
        ),
        StemRule(10, (0.12, 1.0), 0.40, (1.0, 0.8, 0.35), (58.0, 42.0), -0.25, 0.08, points=3),
    ),
    bark=((0.30, 0.23, 0.18), (0.33, 0.24, 0.15)),
    foliage=Foliage(
        1.3, ((0.12, 0.21, 0.11), (0.26, 0.37, 0.19)), (55.0, 30.0), (0.0, 1.0),
        shoot_m=(0.05, 0.25), twig=0.03),
    inner=1.5,
)  # fmt: skip

PINE = WoodyPlant(
    most_triangles=TREE_TRIANGLES,
    trunks=1,
    lean=0.12,
    height=0.95,
    radius=0.021,
    trunk=StemRule(1, bend=0.15, wander=0.2, points=8, taper=0.2),
    orders=(
        StemRule(
            24, (0.18, 1.0), 0.40, (1.0, 0.9, 0.4), (82.0, 42.0), 0.45, 0.22, points=5,
            thickness=0.4,
        ),
        StemRule(9, (0.25, 1.0), 0.36, (0.9, 1.0, 0.8), (50.0, 32.0), 0.6, 0.15, points=3),
    ),
    bark=((0.42, 0.29, 0.20), (0.38, 0.28, 0.19)),
    foliage=Foliage(
        1.3, ((0.17, 0.27, 0.14), (0.32, 0.43, 0.23)), (55.0, 22.0), (0.1, 1.0),
        shoot_m=(0.08, 0.25), twig=0.03, slim=True),
    inner=0.6,
)  # fmt: skip

DWARF_PINE = WoodyPlant(
    trunks=8,
    lean=1.6,
    height=0.6,
    radius=0.016,
    trunk=StemRule(1, bend=1.1, wander=0.25, points=7),
    orders=(
        StemRule(9, (0.2, 1.0), 0.42, (0.9, 1.0, 0.7), (50.0, 30.0), 0.6, 0.2, points=4),
        StemRule(5, (0.2, 1.0), 0.45, (0.9, 1.0, 0.8), (45.0, 30.0), 0.5, 0.15, points=3),
    ),
    bark=((0.33, 0.26, 0.21), (0.38, 0.29, 0.20)),
    foliage=Foliage(
        1.75,
        ((0.15, 0.25, 0.12), (0.29, 0.40, 0.18)),
        (55.0, 22.0),
        shoot_m=(0.05, 0.20),
        twig=0.03,
        slim=True,
    ),
    inner=0.6,
)
