"""Grasses, flowers and ferns.

The public functions are `PlantBuilder`s. Blades are as long as the plant, but not wider; meadows
wider than 1 m have more of them instead of longer ones, up to a bound.
"""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.plants.growth import (
    UP,
    StemRule,
    Stems,
    branches,
    level_vectors,
    stems,
    unit,
)
from oaisys_core.procedural.scatter.plants.organ_sizes import ORGANS, OrganSize, inner
from oaisys_core.procedural.scatter.plants.organs import (
    Organs,
    add_blades,
    add_leaves,
    add_needles,
    add_stems,
    shades,
)
from oaisys_core.types import FloatArray

LUSH, FRESH, STRAW = (0.27, 0.38, 0.13), (0.44, 0.53, 0.21), (0.68, 0.61, 0.40)
SEDGE, SEDGE_TIP = (0.16, 0.25, 0.09), (0.44, 0.40, 0.20)
REED, REED_TIP, PLUME = (0.28, 0.36, 0.16), (0.50, 0.50, 0.26), (0.42, 0.34, 0.27)
BRACKEN, BRACKEN_TIP, BRACKEN_OLD = (0.20, 0.34, 0.09), (0.38, 0.48, 0.16), (0.50, 0.34, 0.16)
WHITE, YELLOW, CLOVER = (0.90, 0.89, 0.84), (0.85, 0.66, 0.10), (0.62, 0.36, 0.55)

MAX_BLADES, MAX_STALKS = 4000, 100
"""Largest numbers of blades of one kind and of stalks in a meadow, at any size."""

RIM_STUNTING = 0.55
"""Share of their length that blades at the rim of a patch of meadow lack."""

GRAIN_M, HAIR_M = 0.005, 0.005
"""Widths of grains in ears, and of the branches of a reed's plume."""


def meadow(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a patch of meadow, 1 m wide: grass of three heights and some stalks with ears."""
    parts = MeshBuilder()
    blade = ORGANS["meadow"]["blade"]
    _grass(parts, rng, blade, unit_m, size_m, count=520, spread=0.5, length=(0.08, 0.22), lean=0.45)
    _grass(parts, rng, blade, unit_m, size_m, count=200, spread=0.47, length=(0.2, 0.36), lean=0.25)
    low = max(size_m, 1.0)
    count = min(round(14 * low**2), MAX_STALKS)
    _ears(parts, rng, unit_m, count=count, spread=0.42, length=(0.32 / low, 0.48 / low))
    return parts


def flower_meadow(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a patch of meadow, 1 m wide, with daisies, hawkweed and clover."""
    parts = MeshBuilder()
    blade = ORGANS["flower_meadow"]["blade"]
    _grass(parts, rng, blade, unit_m, size_m, count=520, spread=0.5, length=(0.07, 0.18), lean=0.5)
    _grass(parts, rng, blade, unit_m, size_m, count=70, spread=0.45, length=(0.18, 0.3), lean=0.25)
    for color, share in ((WHITE, 1.0), (YELLOW, 0.5), (CLOVER, 0.1)):
        count = min(round(int(rng.integers(3, 14)) * max(size_m, 1.0) ** 2), MAX_STALKS)
        _flowers(parts, rng, unit_m, size_m, count=count, color=color, share=share)
    return parts


def sedge(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a dense tussock of arching leaves, as on wet ground."""
    parts = MeshBuilder()
    blade = ORGANS["sedge"]["blade"]
    count = int(np.clip(150 * 0.0135 * size_m / blade.mean_width_m, 20, 1500))
    leaves = _bunch(rng, count, 0.1, (0.5, 1.05), lean=0.42, bend=-1.3, points=6)
    feet = shades(rng, SEDGE, STRAW, count) * 0.8
    tips = shades(rng, SEDGE_TIP, STRAW, count)
    add_blades(parts, leaves, blade.draw(count, rng, unit_m)[1], feet, tips, rng)
    _ears(parts, rng, unit_m, count=9, spread=0.08, length=(0.7, 1.0), head=(0.30, 0.22, 0.12))
    return parts


def reed(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a stand of reed: upright stalks with long leaves and plumes."""
    parts = MeshBuilder()
    count = 20
    stalks = _bunch(rng, count, 0.13, (0.72, 1.0), lean=0.07, bend=-0.05, points=6, radius=0.0035)
    add_stems(parts, stalks, shades(rng, REED, REED_TIP, count))
    blade = ORGANS["reed"]["blade"]
    length = min(0.34, 0.8 * inner(blade.length_m)[1] / size_m)
    each = int(np.clip(round(7 * 0.34 / length), 7, 40))
    rule = StemRule(
        each, (0.12, 0.9), length, (1.0, 1.1, 0.7), (38.0, 24.0), bend=-0.7, wander=0.12, points=5
    )
    leaves = branches(stalks, rule, rng)
    number = len(leaves.points_m)
    tips = shades(rng, REED_TIP, STRAW, number)
    add_blades(
        parts, leaves, blade.draw(number, rng, unit_m)[1],
        shades(rng, REED, REED_TIP, number), tips, rng,
    )  # fmt: skip
    plume = StemRule(16, (0.9, 1.0), 0.1, (1.0, 0.9, 0.4), (45.0, 20.0), bend=-0.6, points=3)
    hairs = branches(stalks, plume, rng)
    number = len(hairs.points_m)
    color = shades(rng, PLUME, STRAW, number)
    add_blades(parts, hairs, np.full(number, HAIR_M / unit_m), color, color, rng)
    return parts


def bracken(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a stand of bracken: each stalk carries one broad triangular frond, twice divided."""
    parts = MeshBuilder()
    count = 6
    stalks = _bunch(rng, count, 0.12, (0.75, 1.0), lean=0.55, bend=-0.35, points=8, radius=0.006)
    add_stems(parts, stalks, shades(rng, BRACKEN_OLD, BRACKEN, count))
    old = rng.uniform(size=count) ** 3
    shares = np.linspace(0.34, 0.985, 15)
    for sign in (-1.0, 1.0):
        rule = StemRule(len(shares), points=6, taper=0.2)
        ribs = _pinnae(stalks, shares, sign, reach=(0.46, 0.04), rule=rule, rng=rng)
        for other in (-1.0, 1.0):
            _leaflets(parts, ribs, other, np.repeat(old, len(shares)), unit_m, size_m, rng)
    return parts


def _pinnae(
    parents: Stems,
    shares: FloatArray,
    sign: float,
    reach: tuple[float, float],
    rule: StemRule,
    rng: np.random.Generator,
) -> Stems:
    """Return the side ribs of fronds on one side, shorter towards the tip."""
    count, number = len(parents.points_m), len(shares)
    feet, along, radii = parents.at(np.tile(shares, (count, 1)))
    side = unit(np.cross(along, UP)) * sign
    ways = unit(side + 0.45 * along + 0.08 * rng.normal(size=side.shape))
    lengths = np.interp(shares, (shares[0], shares[-1]), reach) * rng.uniform(
        0.9, 1.1, (count, number)
    )
    bent = StemRule(number, bend=-0.22, wander=0.05, points=rule.points, taper=rule.taper)
    return stems(
        feet.reshape(-1, 3), ways.reshape(-1, 3), lengths.ravel(), 0.4 * radii.ravel(), bent, rng
    )


def _leaflets(
    parts: MeshBuilder,
    ribs: Stems,
    sign: float,
    old: FloatArray,
    unit_m: float,
    size_m: float,
    rng: np.random.Generator,
) -> None:
    """Add leaflets on one side of ribs; ``old`` (S,) is 1 where they are brown."""
    (shortest, longest), (thinnest, broadest) = (
        np.array(inner(limits)) / unit_m
        for limits in (ORGANS["bracken"]["leaf"].length_m, ORGANS["bracken"]["leaf"].width_m)
    )
    number = int(np.clip(9 * size_m, 9, 20))
    shares = np.tile(np.linspace(0.06, 0.97, number), (len(ribs.points_m), 1))
    feet, along, _ = ribs.at(shares)
    side = unit(np.cross(along, UP)) * sign
    lengths = 0.26 * ribs.lengths_m[:, None] * (1.02 - 0.8 * shares) + 0.012
    lengths = np.clip(lengths, shortest, longest)
    count = shares.size
    green = shades(rng, BRACKEN, BRACKEN_TIP, count)
    brown = shades(rng, BRACKEN_OLD, STRAW, count)
    share = np.repeat(old, number)[:, None]
    add_leaves(
        parts,
        Organs(
            feet.reshape(-1, 3),
            (side + 0.35 * along).reshape(-1, 3),
            lengths.ravel(),
            np.clip(0.42 * lengths.ravel(), thinnest, broadest),
            green + (brown - green) * share,
        ),
        rng,
        fold=0.1,
        droop=0.1,
        face_up=4.0,
    )


def _grass(
    parts: MeshBuilder,
    rng: np.random.Generator,
    blade: OrganSize,
    unit_m: float,
    size_m: float,
    *,
    count: int,
    spread: float,
    length: tuple[float, float],
    lean: float,
) -> None:
    """Add blades of grass that grow in tufts within a disc of the radius ``spread``.

    Towards its rim they get sparse and short, so that patches blend into each other and into the
    turf around them. ``count`` blades of 7 mm cover a meadow of 1 m; there are as many as cover
    this one.
    """
    low = max(size_m, 1.0)
    count = min(round(count * 0.007 * size_m * low / blade.mean_width_m), MAX_BLADES)
    count = max(count, 10)
    length = (length[0] / low, length[1] / low)
    tufts = count // 5
    edge = np.sqrt(1 - np.sqrt(rng.uniform(size=tufts)))
    centres = spread * edge[:, None] * _around(rng, tufts)
    vigour = 1 - RIM_STUNTING * edge**2
    dry = rng.uniform(size=tufts) ** 2
    tuft = rng.integers(tufts, size=count)
    feet = centres[tuft] + 0.035 / low * level_vectors(rng, count)
    leaning = centres[tuft] * 0.25 + lean * level_vectors(rng, count)
    leaves = stems(
        feet,
        UP + leaning,
        vigour[tuft] * rng.uniform(*length, count),
        np.zeros(count),
        StemRule(1, bend=-0.8, wander=0.15, points=4),
        rng,
    )
    share = (0.15 + 0.85 * dry[tuft] * rng.uniform(size=count))[:, None]
    foot = shades(rng, LUSH, FRESH, count) * 0.75
    tips = shades(rng, FRESH, LUSH, count)
    tips = tips + (np.asarray(STRAW) - tips) * share
    foot = foot + (0.7 * np.asarray(STRAW) - foot) * 0.5 * share
    add_blades(parts, leaves, blade.draw(count, rng, unit_m)[1], foot, tips, rng)


def _ears(
    parts: MeshBuilder,
    rng: np.random.Generator,
    unit_m: float,
    *,
    count: int,
    spread: float,
    length: tuple[float, float],
    head: tuple[float, float, float] = (0.58, 0.48, 0.30),
) -> None:
    """Add stalks with ears of grain."""
    stalks = _bunch(rng, count, spread, length, lean=0.16, bend=-0.4, points=5, radius=0.0016)
    add_stems(parts, stalks, shades(rng, STRAW, FRESH, count))
    rule = StemRule(12, (0.84, 1.0), 0.07, (0.7, 1.0, 0.5), (30.0, 14.0), points=3, jitter=0.3)
    grains = branches(stalks, rule, rng)
    number = len(grains.points_m)
    color = shades(rng, head, STRAW, number)
    add_blades(parts, grains, np.full(number, GRAIN_M / unit_m), color, color, rng)


def _flowers(
    parts: MeshBuilder,
    rng: np.random.Generator,
    unit_m: float,
    size_m: float,
    *,
    count: int,
    color: tuple[float, float, float],
    share: float,
) -> None:
    """Add stalks that end in flowers of eight petals, from small (0) to large (``share`` 1)."""
    petal = ORGANS["flower_meadow"]["flower"]
    size, width = (
        (low + (high - low) * share) / unit_m
        for low, high in (inner(petal.length_m), inner(petal.width_m))
    )
    low = max(size_m, 1.0)
    stalks = _bunch(
        rng, count, 0.42, (0.2 / low, 0.34 / low), lean=0.18, bend=0.1, points=4, radius=0.0014
    )
    add_stems(parts, stalks, shades(rng, LUSH, FRESH, count))
    ends, along, _ = stalks.at(np.ones((count, 1)))
    petals = 8
    angle = np.linspace(0, 2 * np.pi, petals, endpoint=False)
    out = np.column_stack((np.cos(angle), np.sin(angle), np.full(petals, 0.25)))
    ways = unit(out[None] + 0.6 * along)
    add_leaves(
        parts,
        Organs(
            np.repeat(ends[:, 0], petals, axis=0),
            ways.reshape(-1, 3),
            np.full(count * petals, size),
            np.full(count * petals, width),
            shades(rng, color, color, count * petals, 0.05),
        ),
        rng,
        droop=0.05,
        face_up=4.0,
    )
    hearts = np.repeat(ends[:, 0], 6, axis=0) + 0.002 / unit_m * rng.normal(size=(6 * count, 3))
    add_needles(
        parts,
        Organs(
            hearts,
            UP + rng.normal(0, 0.5, (6 * count, 3)),
            np.full(6 * count, 0.35 * size),
            np.full(6 * count, 0.42 * size),
            shades(rng, YELLOW, (0.6, 0.4, 0.1), 6 * count),
        ),
        rng,
    )


def _bunch(
    rng: np.random.Generator,
    count: int,
    spread: float,
    length: tuple[float, float],
    *,
    lean: float,
    bend: float,
    points: int,
    radius: float = 0.0,
) -> Stems:
    """Return stems from a disc of the radius ``spread``, leaning outwards."""
    feet = _disc(rng, count, spread)
    out: FloatArray = feet / max(spread, 1e-6) * lean + 0.5 * lean * level_vectors(rng, count)
    rule = StemRule(1, bend=bend, wander=0.12, points=points, taper=0.35)
    lengths = rng.uniform(*length, count)
    return stems(feet, UP + out, lengths, np.full(count, radius), rule, rng)


def _disc(rng: np.random.Generator, count: int, radius: float) -> FloatArray:
    """Return (count, 3) points on a level disc."""
    ways = _around(rng, count)
    return np.asarray(radius * np.sqrt(rng.uniform(size=count))[:, None] * ways)


def _around(rng: np.random.Generator, count: int) -> FloatArray:
    """Return (count, 3) level unit vectors."""
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.column_stack((np.cos(angle), np.sin(angle), np.zeros(count)))
