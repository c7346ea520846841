"""Shrubs and small trees: stems in several orders with leaves or needles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oaisys_core.scatter.mesh_builder import MeshBuilder
from oaisys_core.scatter.plants.growth import (
    UP,
    StemRule,
    Stems,
    branches,
    departures,
    spread_shares,
    stems,
)
from oaisys_core.scatter.plants.organs import add_leaves, add_needles, add_stems, shades
from oaisys_core.scene import MeshPrototype
from oaisys_core.types import FloatArray

Color = tuple[float, float, float]


@dataclass(frozen=True)
class Foliage:
    """Leaves or needles on the stems of the highest order.

    Attributes:
        number: On each stem.
        size: Length, in heights of the plant.
        width: Share of the length.
        colors: Of young and of old ones, or of shade and light.
        angle_deg: From the stem, at its foot and at its tip.
        span: Shares of the stem's length on which they grow.
        are_needles: Whether they have one triangle instead of four.
        droop: See `add_leaves`.
    """

    number: int
    size: float
    width: float
    colors: tuple[Color, Color]
    angle_deg: tuple[float, float] = (70.0, 35.0)
    span: tuple[float, float] = (0.1, 1.0)
    are_needles: bool = False
    droop: float = 0.25


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

    def grow(self, name: str, rng: np.random.Generator) -> MeshPrototype:
        """Return a plant, 1 m high or wide."""
        parts = MeshBuilder()
        order = self._trunks(rng)
        orders = [order]
        for rule in self.orders:
            order = branches(order, rule, rng)
            orders.append(order)
        for level, stem in enumerate(orders):
            share = level / max(len(orders) - 1, 1)
            color = np.asarray(self.bark[0]) * (1 - share) + np.asarray(self.bark[1]) * share
            bright = rng.uniform(0.8, 1.15, (len(stem.points_m), 1))
            add_stems(parts, stem, bright * color, sides=5 if level == 0 else 3)
        _dress(parts, orders[-1], self.foliage, self.foliage.number, rng)
        inner = round(self.inner * self.foliage.number)
        if inner:
            _dress(parts, orders[-2], self.foliage, inner, rng)
        if self.flowers is not None:
            _dress(parts, orders[-1], self.flowers, self.flowers.number, rng)
        return parts.mesh_of_size_1(name)

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


def _dress(
    parts: MeshBuilder, stem: Stems, foliage: Foliage, number: int, rng: np.random.Generator
) -> None:
    """Add leaves or needles to stems; outer and upper ones are brighter."""
    shares = spread_shares(len(stem.points_m), number, foliage.span, rng)
    feet, directions, _ = departures(stem, shares, foliage.angle_deg, 0.2, rng)
    feet, directions = feet.reshape(-1, 3), directions.reshape(-1, 3)
    lengths = foliage.size * rng.uniform(0.7, 1.2, len(feet))
    light = _light(feet)
    colors = shades(rng, *foliage.colors, len(feet)) * light[:, None]
    if foliage.are_needles:
        add_needles(parts, feet, directions, lengths, foliage.width, colors, rng)
        return
    add_leaves(
        parts, feet, directions, lengths, foliage.width, colors, rng, droop=foliage.droop
    )  # fmt: skip


def _light(feet: FloatArray) -> FloatArray:
    """Return (N,) brightness factors: leaves outside and above are paler than those within."""
    centre = feet.mean(axis=0)
    reach = np.maximum(np.ptp(feet, axis=0) / 2, 1e-6)
    away = np.linalg.norm((feet - centre) / reach, axis=1)
    return np.asarray(np.clip(0.72 + 0.3 * np.clip(away, 0, 1.2), 0.7, 1.1))


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
    foliage=Foliage(30, 0.028, 0.30, ((0.22, 0.27, 0.11), (0.34, 0.36, 0.17)), are_needles=True),
    inner=0.6,
    flowers=Foliage(
        14, 0.018, 0.9, ((0.58, 0.30, 0.50), (0.74, 0.52, 0.66)), (75.0, 50.0), (0.45, 1.0),
        are_needles=True,
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
        26, 0.040, 0.17, ((0.16, 0.25, 0.15), (0.33, 0.42, 0.28)), (60.0, 30.0), are_needles=True
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
        8, 0.066, 0.23, ((0.28, 0.37, 0.19), (0.46, 0.52, 0.34)), (50.0, 28.0), droop=0.3
    ),
    inner=0.5,
)

BIRCH = WoodyPlant(
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
    foliage=Foliage(12, 0.030, 0.78, ((0.25, 0.38, 0.10), (0.45, 0.54, 0.17)), (75.0, 50.0)),
    inner=0.8,
)  # fmt: skip

OAK = WoodyPlant(
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
    foliage=Foliage(11, 0.042, 0.6, ((0.20, 0.31, 0.09), (0.36, 0.45, 0.15)), (65.0, 40.0)),
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
    foliage=Foliage(11, 0.036, 0.75, ((0.17, 0.29, 0.08), (0.34, 0.44, 0.14)), (70.0, 45.0)),
    inner=0.6,
    flowers=Foliage(
        3, 0.018, 1.0, ((0.88, 0.87, 0.80), (0.86, 0.78, 0.76)), (70.0, 45.0), (0.4, 1.0)
    ),
)

SPRUCE = WoodyPlant(
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
        26, 0.026, 0.20, ((0.12, 0.21, 0.11), (0.26, 0.37, 0.19)), (55.0, 30.0), (0.0, 1.0),
        are_needles=True,
    ),
    inner=1.5,
)  # fmt: skip

PINE = WoodyPlant(
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
        48, 0.056, 0.085, ((0.17, 0.27, 0.14), (0.32, 0.43, 0.23)), (55.0, 22.0), (0.1, 1.0),
        are_needles=True,
    ),
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
        40, 0.066, 0.085, ((0.15, 0.25, 0.12), (0.29, 0.40, 0.18)), (55.0, 22.0), are_needles=True
    ),
    inner=0.6,
)
