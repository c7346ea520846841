"""Grasses, flowers and ferns."""

from __future__ import annotations

import numpy as np

from oaisys_core.scatter.mesh_builder import MeshBuilder
from oaisys_core.scatter.plants.growth import UP, StemRule, Stems, branches, stems, unit
from oaisys_core.scatter.plants.organs import (
    add_blades,
    add_leaves,
    add_needles,
    add_stems,
    shades,
)
from oaisys_core.scene import MeshPrototype
from oaisys_core.types import FloatArray

LUSH, FRESH, STRAW = (0.27, 0.38, 0.13), (0.44, 0.53, 0.21), (0.68, 0.61, 0.40)
SEDGE, SEDGE_TIP = (0.16, 0.25, 0.09), (0.44, 0.40, 0.20)
REED, REED_TIP, PLUME = (0.28, 0.36, 0.16), (0.50, 0.50, 0.26), (0.42, 0.34, 0.27)
BRACKEN, BRACKEN_TIP, BRACKEN_OLD = (0.20, 0.34, 0.09), (0.38, 0.48, 0.16), (0.50, 0.34, 0.16)
WHITE, YELLOW, CLOVER = (0.90, 0.89, 0.84), (0.85, 0.66, 0.10), (0.62, 0.36, 0.55)


def meadow(rng: np.random.Generator) -> MeshPrototype:
    """Return a patch of meadow, 1 m wide: grass of three heights and some stalks with ears."""
    parts = MeshBuilder()
    _grass(parts, rng, count=520, spread=0.5, length=(0.08, 0.22), lean=0.45, width=0.007)
    _grass(parts, rng, count=200, spread=0.47, length=(0.2, 0.36), lean=0.25, width=0.007)
    _ears(parts, rng, count=14, spread=0.42, length=(0.32, 0.48))
    return parts.mesh_of_size_1("meadow")


def flower_meadow(rng: np.random.Generator) -> MeshPrototype:
    """Return a patch of meadow, 1 m wide, with daisies, hawkweed and clover."""
    parts = MeshBuilder()
    _grass(parts, rng, count=520, spread=0.5, length=(0.07, 0.18), lean=0.5, width=0.007)
    _grass(parts, rng, count=70, spread=0.45, length=(0.18, 0.3), lean=0.25, width=0.006)
    for color, size in ((WHITE, 0.020), (YELLOW, 0.016), (CLOVER, 0.013)):
        _flowers(parts, rng, count=int(rng.integers(3, 14)), color=color, size=size)
    return parts.mesh_of_size_1("flower_meadow")


def sedge(rng: np.random.Generator) -> MeshPrototype:
    """Return a dense tussock of arching leaves, as on wet ground."""
    parts = MeshBuilder()
    count = 150
    leaves = _bunch(rng, count, 0.1, (0.5, 1.05), lean=0.42, bend=-1.3, points=6)
    feet = shades(rng, SEDGE, STRAW, count) * 0.8
    tips = shades(rng, SEDGE_TIP, STRAW, count)
    add_blades(parts, leaves, rng.uniform(0.010, 0.017, count), feet, tips, rng)
    _ears(parts, rng, count=9, spread=0.08, length=(0.7, 1.0), head=(0.30, 0.22, 0.12))
    return parts.mesh_of_size_1("sedge")


def reed(rng: np.random.Generator) -> MeshPrototype:
    """Return a stand of reed: upright stalks with long leaves and plumes."""
    parts = MeshBuilder()
    count = 20
    stalks = _bunch(rng, count, 0.13, (0.72, 1.0), lean=0.07, bend=-0.05, points=6, radius=0.0035)
    add_stems(parts, stalks, shades(rng, REED, REED_TIP, count))
    rule = StemRule(
        7, (0.12, 0.9), 0.34, (1.0, 1.1, 0.7), (38.0, 24.0), bend=-0.7, wander=0.12, points=5
    )
    leaves = branches(stalks, rule, rng)
    number = len(leaves.points_m)
    tips = shades(rng, REED_TIP, STRAW, number)
    add_blades(
        parts, leaves, rng.uniform(0.012, 0.02, number), shades(rng, REED, REED_TIP, number), tips,
        rng,
    )  # fmt: skip
    plume = StemRule(16, (0.9, 1.0), 0.1, (1.0, 0.9, 0.4), (45.0, 20.0), bend=-0.6, points=3)
    hairs = branches(stalks, plume, rng)
    number = len(hairs.points_m)
    color = shades(rng, PLUME, STRAW, number)
    add_blades(parts, hairs, np.full(number, 0.008), color, color, rng)
    return parts.mesh_of_size_1("reed")


def bracken(rng: np.random.Generator) -> MeshPrototype:
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
            _leaflets(parts, ribs, other, np.repeat(old, len(shares)), rng)
    return parts.mesh_of_size_1("bracken")


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
    parts: MeshBuilder, ribs: Stems, sign: float, old: FloatArray, rng: np.random.Generator
) -> None:
    """Add leaflets on one side of ribs; ``old`` (S,) is 1 where they are brown."""
    number = 9
    shares = np.tile(np.linspace(0.06, 0.97, number), (len(ribs.points_m), 1))
    feet, along, _ = ribs.at(shares)
    side = unit(np.cross(along, UP)) * sign
    lengths = 0.26 * ribs.lengths_m[:, None] * (1.02 - 0.8 * shares) + 0.012
    count = shares.size
    green = shades(rng, BRACKEN, BRACKEN_TIP, count)
    brown = shades(rng, BRACKEN_OLD, STRAW, count)
    share = np.repeat(old, number)[:, None]
    add_leaves(
        parts,
        feet.reshape(-1, 3),
        (side + 0.35 * along).reshape(-1, 3),
        lengths.ravel(),
        0.42,
        green + (brown - green) * share,
        rng,
        fold=0.1,
        droop=0.1,
        face_up=4.0,
    )


def _grass(
    parts: MeshBuilder,
    rng: np.random.Generator,
    *,
    count: int,
    spread: float,
    length: tuple[float, float],
    lean: float,
    width: float,
) -> None:
    """Add blades of grass that grow in tufts within a disc of the radius ``spread``."""
    tufts = count // 5
    centres = _disc(rng, tufts, spread)
    dry = rng.uniform(size=tufts) ** 2
    tuft = rng.integers(tufts, size=count)
    feet = centres[tuft] + 0.035 * _level(rng, count)
    leaning = centres[tuft] * 0.25 + lean * _level(rng, count)
    leaves = stems(
        feet,
        UP + leaning,
        rng.uniform(*length, count),
        np.zeros(count),
        StemRule(1, bend=-0.8, wander=0.15, points=4),
        rng,
    )
    share = (0.15 + 0.85 * dry[tuft] * rng.uniform(size=count))[:, None]
    low = shades(rng, LUSH, FRESH, count) * 0.75
    tips = shades(rng, FRESH, LUSH, count)
    tips = tips + (np.asarray(STRAW) - tips) * share
    low = low + (0.7 * np.asarray(STRAW) - low) * 0.5 * share
    add_blades(parts, leaves, rng.uniform(0.7, 1.3, count) * width, low, tips, rng)


def _ears(
    parts: MeshBuilder,
    rng: np.random.Generator,
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
    add_blades(parts, grains, np.full(number, 0.006), color, color, rng)


def _flowers(
    parts: MeshBuilder,
    rng: np.random.Generator,
    *,
    count: int,
    color: tuple[float, float, float],
    size: float,
) -> None:
    """Add stalks that end in flowers of eight petals."""
    stalks = _bunch(rng, count, 0.42, (0.2, 0.34), lean=0.18, bend=0.1, points=4, radius=0.0014)
    add_stems(parts, stalks, shades(rng, LUSH, FRESH, count))
    ends, along, _ = stalks.at(np.ones((count, 1)))
    petals = 8
    angle = np.linspace(0, 2 * np.pi, petals, endpoint=False)
    out = np.column_stack((np.cos(angle), np.sin(angle), np.full(petals, 0.25)))
    ways = unit(out[None] + 0.6 * along)
    add_leaves(
        parts,
        np.repeat(ends[:, 0], petals, axis=0),
        ways.reshape(-1, 3),
        np.full(count * petals, size),
        0.7,
        shades(rng, color, color, count * petals, 0.05),
        rng,
        droop=0.05,
        face_up=4.0,
    )
    hearts = np.repeat(ends[:, 0], 6, axis=0) + 0.002 * rng.normal(size=(6 * count, 3))
    add_needles(
        parts,
        hearts,
        UP + rng.normal(0, 0.5, (6 * count, 3)),
        np.full(6 * count, 0.35 * size),
        1.2,
        shades(rng, YELLOW, (0.6, 0.4, 0.1), 6 * count),
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
    out: FloatArray = feet / max(spread, 1e-6) * lean + 0.5 * lean * _level(rng, count)
    rule = StemRule(1, bend=bend, wander=0.12, points=points, taper=0.35)
    lengths = rng.uniform(*length, count)
    return stems(feet, UP + out, lengths, np.full(count, radius), rule, rng)


def _level(rng: np.random.Generator, count: int) -> FloatArray:
    """Return (count, 3) random level vectors, normal along both axes."""
    vectors = rng.normal(size=(count, 3))
    vectors[:, 2] = 0.0
    return vectors


def _disc(rng: np.random.Generator, count: int, radius: float) -> FloatArray:
    """Return (count, 3) points on a level disc."""
    angle = rng.uniform(0, 2 * np.pi, count)
    distance = radius * np.sqrt(rng.uniform(size=count))
    return np.column_stack((distance * np.cos(angle), distance * np.sin(angle), np.zeros(count)))
