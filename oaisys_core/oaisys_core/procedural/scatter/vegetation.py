"""Low plants made of leaves and twigs, some 1 m large, foot at the origin.

The functions are `PlantBuilder`s: leaves have the sizes of `ORGANS`.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.plants.fitting import PlantGenerator, fit_to_size
from oaisys_core.procedural.scatter.plants.growth import GOLDEN_RAD, StemRule
from oaisys_core.procedural.scatter.plants.growth import stems as grow
from oaisys_core.procedural.scatter.plants.moss import moss_cushion
from oaisys_core.procedural.scatter.plants.organ_sizes import MARGIN, ORGANS, inner
from oaisys_core.procedural.scatter.plants.organs import (
    LEAF_TRANSLUCENCY,
    Organs,
    add_kites,
    add_stems,
    mix_colors,
)
from oaisys_core.types import FloatArray

UP = np.array((0.0, 0.0, 1.0))

MAX_BLADES, MAX_LEAVES, MAX_ROSETTES, MAX_TWIGS = 2000, 12_000, 50, 2000
"""Largest numbers of blades of a tuft, leaves of a shrub, rosettes of a clump and twigs of a dry
bush, at any size."""

SHRUB_COVER = 0.8
"""Area of the leaves of a shrub of 1 m, in m²."""

GRASS, STRAW = (0.20, 0.30, 0.09), (0.62, 0.55, 0.34)
FERN, FERN_TIP = (0.13, 0.26, 0.07), (0.32, 0.44, 0.14)
LEAF, LEAF_OLD = (0.27, 0.36, 0.15), (0.45, 0.45, 0.22)
SUCCULENT, SUCCULENT_TIP = (0.31, 0.42, 0.31), (0.52, 0.38, 0.30)
BARK, DRY_WOOD = (0.26, 0.20, 0.15), (0.50, 0.42, 0.33)


def grass_tuft(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a tuft of bent blades of 3 to 8 mm, some of them dry; a larger one has more."""
    parts = MeshBuilder()
    blade = ORGANS["grass_tuft"]["blade"]
    count = int(np.clip(34 * 0.026 * size_m / blade.mean_width_m, 12, MAX_BLADES))
    _, widths = blade.draw(count, rng, unit_m)
    for full_width in widths:
        azimuth = rng.uniform(0, 2 * np.pi)
        lean = min(abs(rng.normal(0.0, 0.38)) + 0.05, 0.9)
        length = rng.uniform(0.55, 1.1)
        foot = 0.09 * np.sqrt(rng.uniform()) * _way(azimuth + rng.normal(0, 0.5))
        spine = _arch(foot, azimuth, lean, rng.uniform(0.3, 1.1), length, 5)
        width = 0.5 * full_width * np.array((0.8, 1.0, 0.85, 0.55, 0.1))
        dry = rng.uniform() ** 3
        tip = mix_colors(_shade(GRASS, rng), STRAW, 0.25 + 0.75 * dry)
        foot_color = mix_colors(0.7 * np.array(GRASS), STRAW, 0.35 + 0.5 * dry)
        _leaf(parts, spine, width, _gradient(foot_color, tip, 5), rng.normal(0, 0.4))
    return parts


def fern(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a crown of arching fronds with leaflets on both sides; longer ones have more."""
    parts = MeshBuilder()
    leaflet = ORGANS["fern"]["leaf"]
    longest, (thinnest, broadest) = (
        leaflet.length_m[1] / MARGIN / unit_m,
        np.array(inner(leaflet.width_m)) / unit_m,
    )
    number = int(np.clip(0.5 * size_m / leaflet.mean_width_m, 14, 60))
    fronds = 11
    for frond in range(fronds):
        azimuth = 2 * np.pi * (frond + rng.uniform(-0.3, 0.3)) / fronds
        length = rng.uniform(0.75, 1.05)
        spine = _arch(
            np.zeros(3), azimuth, rng.uniform(0.35, 0.7), rng.uniform(0.7, 1.2), length, number
        )
        young = rng.uniform()
        near, far = (
            mix_colors(_shade(FERN, rng), FERN_TIP, 0.3 * young),
            mix_colors(FERN, FERN_TIP, young),
        )
        rib = spine[np.linspace(0, number - 1, 5).astype(int)]
        parts.tube(rib, np.linspace(0.007, 0.002, 5), mix_colors(BARK, FERN, 0.6))
        side = np.cross(_way(azimuth), UP)
        for k in range(number // 7, number):
            share = k / (number - 1)
            reach = 0.30 * length * np.sin(np.pi * share**0.8) ** 0.8 * (1 - 0.45 * share)
            reach = float(np.clip(reach + 0.02, leaflet.length_m[0] * MARGIN / unit_m, longest))
            ahead = spine[min(k + 1, number - 1)] - spine[k - 1]
            ahead /= np.linalg.norm(ahead)
            for sign in (-1.0, 1.0):
                way = sign * side + 0.45 * ahead - 0.18 * UP
                tip = spine[k] + reach * way / np.linalg.norm(way)
                broad = 0.5 * np.clip(0.75 * length / number, thinnest, broadest) * ahead
                middle = 0.55 * spine[k] + 0.45 * tip + 0.02 * reach * UP
                left = np.array((spine[k] - 0.6 * broad, middle - broad, tip))
                right = np.array((spine[k] + 0.6 * broad, middle + broad, tip))
                colors = _gradient(near, mix_colors(near, far, share), 3)
                parts.strip(left, right, colors, translucency=LEAF_TRANSLUCENCY)
    return parts


def rosette(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a rosette of thick, channelled leaves; a larger plant is a clump of rosettes."""
    parts = MeshBuilder()
    leaf = ORGANS["rosette"]["leaf"]
    longest_m = min(inner(leaf.length_m)[1], 0.5 * size_m)
    share = min(2 * longest_m / size_m, 1.0)
    rosettes = int(np.clip(1.3 / share**2, 1, MAX_ROSETTES))
    for number in range(rosettes):
        turn, distance = number * GOLDEN_RAD, np.sqrt(number / max(rosettes - 1, 1))
        foot = 0.5 * (1 - share) * distance * _way(turn)
        _add_rosette(parts, rng, foot, longest_m * rng.uniform(0.85, 1.0), unit_m)
    return parts


def _add_rosette(
    parts: MeshBuilder, rng: np.random.Generator, foot: FloatArray, longest_m: float, unit_m: float
) -> None:
    """Add leaves around a foot, the inner ones upright and shorter."""
    leaf = ORGANS["rosette"]["leaf"]
    leaves = 30
    for index in range(leaves):
        age = 1 - index / leaves
        azimuth = index * GOLDEN_RAD + rng.normal(0, 0.08)
        length_m = float(np.clip(longest_m * (0.35 + 0.65 * age), *inner(leaf.length_m)))
        width_m = float(np.clip(0.2 * length_m, *inner(leaf.width_m)))
        near = foot + 0.04 * longest_m / unit_m * _way(azimuth)
        spine = _arch(near, azimuth, 0.2 + 1.1 * age, -0.35 * age, length_m / unit_m, 6)
        side = np.cross(_way(azimuth), UP)
        half = 0.5 * width_m / unit_m * np.array((0.75, 0.95, 1.0, 0.85, 0.5, 0.02))[:, None]
        green = _shade(SUCCULENT, rng)
        colors = _gradient(0.75 * green, mix_colors(green, SUCCULENT_TIP, 0.3 + 0.5 * age), 6)
        for sign in (-1.0, 1.0):
            outer = spine + half * _unit(sign * side + 0.35 * UP)
            left, right = (outer, spine) if sign < 0 else (spine, outer)
            parts.strip(left, right, colors)


def shrub(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a rounded shrub: stems that fork, with small leaves all over the outer twigs."""
    parts = MeshBuilder()
    leaf = ORGANS["shrub"]["leaf"]
    leaves = min(SHRUB_COVER * size_m**2 / leaf.area_m2, MAX_LEAVES)
    twigs = _branches(rng, stems=9, forks=(3, 3), length=0.42, spread=0.6, rise=0.35)
    for start, end, level in twigs:
        radius = 0.016 * 0.55**level
        parts.tube((start, end), (radius, 0.6 * radius), _shade(BARK, rng))
        count = rng.poisson(leaves * (0, 0.15, 0.85)[level] / (1, 27, 81)[level])
        foot = start + rng.uniform(0.15, 1.1, (count, 1)) * (end - start)
        ways = (end - start) / np.linalg.norm(end - start) + rng.normal(0, 0.8, (count, 3))
        # Outer and upper leaves get more light; inner ones are older.
        outer = np.clip(np.linalg.norm(foot, axis=1) / 0.9, 0, 1)[:, None]
        color = mix_colors(_shade(LEAF, rng), LEAF_OLD, 0.5 * rng.uniform(size=(count, 1)) ** 2)
        color = (0.6 + 0.6 * outer) * color * rng.uniform(0.85, 1.15, (count, 1))
        organs = Organs(foot, ways, *leaf.draw(count, rng, unit_m), color)
        add_kites(parts, organs, rng)
    return parts


def dry_bush(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a bare bush of crooked, bleached branches, with thin twigs all over the outer ones."""
    parts = MeshBuilder()
    twig = ORGANS["dry_bush"]["twig"]
    twigs = float(np.clip(220 * size_m**2, 120, MAX_TWIGS))
    for start, end, level in _branches(
        rng, stems=8, forks=(3, 3), length=0.36, spread=0.75, rise=0.22
    ):
        radius = 0.011 * 0.55**level
        middle = (start + end) / 2 + rng.normal(0, 0.06, 3) * np.linalg.norm(end - start)
        color = mix_colors(_shade(BARK, rng), _shade(DRY_WOOD, rng), 0.3 + 0.23 * level)
        parts.tube((start, middle, end), (radius, 0.8 * radius, 0.45 * radius), color, sides=4)
        count = rng.poisson(twigs * (0, 0.25, 0.75)[level] / (1, 24, 72)[level])
        feet = middle + rng.uniform(-0.2, 1.0, (count, 1)) * (end - middle)
        ways = (end - start) / np.linalg.norm(end - start) + rng.normal(0, 0.7, (count, 3))
        lengths, widths = twig.draw(count, rng, unit_m)
        lengths = np.minimum(lengths, max(0.2 * size_m, inner(twig.length_m)[0]) / unit_m)
        rule = StemRule(1, bend=0.2, wander=0.3, points=3, taper=0.5)
        thin = grow(feet, ways, lengths, widths / 2, rule, rng)
        add_stems(parts, thin, mix_colors(color, _shade(DRY_WOOD, rng), 0.6))
    return parts


def _branches(
    rng: np.random.Generator,
    *,
    stems: int,
    forks: tuple[int, ...],
    length: float,
    spread: float,
    rise: float,
) -> list[tuple[FloatArray, FloatArray, int]]:
    """Return (start, end, level) of the twigs of a bush whose stems fork again and again."""
    ends = []
    for stem in range(stems):
        way = _way(2 * np.pi * (stem + rng.uniform(-0.3, 0.3)) / stems) * rng.uniform(0.25, 1.0)
        ends.append((np.zeros(3), way + UP * rng.uniform(0.6, 1.1)))
    twigs = []
    for level, number in enumerate((1, *forks)):
        grown = []
        for start, way in ends:
            for _ in range(number):
                turned = way / np.linalg.norm(way) + rng.normal(0, spread if level else 0.15, 3)
                turned[2] = max(turned[2], -0.1) + rise * (level > 0)
                turned /= np.linalg.norm(turned)
                end = start + turned * length * 0.72**level * rng.uniform(0.7, 1.2)
                twigs.append((start, end, level))
                grown.append((end, turned))
        ends = grown
    return twigs


def _arch(
    foot: FloatArray, azimuth: float, lean: float, bend: float, length: float, points: int
) -> FloatArray:
    """Return (points, 3) of a curve that starts ``lean`` off the vertical and then bends."""
    share = np.linspace(0, 1, points)
    angle = lean + bend * share
    step = length / (points - 1)
    out = np.concatenate(([0.0], np.cumsum(np.sin(angle[:-1]) * step)))
    up = np.concatenate(([0.0], np.cumsum(np.cos(angle[:-1]) * step)))
    return np.asarray(foot + out[:, None] * _way(azimuth) + up[:, None] * UP)


def _leaf(
    parts: MeshBuilder, spine: FloatArray, width: FloatArray, colors: FloatArray, twist: float
) -> None:
    """Add a blade with (K,) half widths along a (K, 3) spine, rotated about it by ``twist``."""
    out = spine[-1] - spine[0]
    side = np.cross(out, UP)
    side /= max(float(np.linalg.norm(side)), 1e-9)
    side = np.cos(twist) * side + np.sin(twist) * _unit(np.cross(side, out))
    left, right = spine - width[:, None] * side, spine + width[:, None] * side
    parts.strip(left, right, colors, translucency=LEAF_TRANSLUCENCY)


def _way(azimuth: float) -> FloatArray:
    return np.array((np.cos(azimuth), np.sin(azimuth), 0.0))


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))


def _gradient(first: ArrayLike, last: ArrayLike, count: int) -> FloatArray:
    return mix_colors(np.asarray(first), np.asarray(last), np.linspace(0, 1, count)[:, None])


def _shade(color: ArrayLike, rng: np.random.Generator) -> FloatArray:
    """Return a colour a little brighter or darker, yellower or bluer."""
    tint = np.array((1.0, 1.0, 1.0)) + rng.normal(0, 0.06) * np.array((1.0, 0.3, -0.8))
    return np.asarray(np.asarray(color) * rng.uniform(0.82, 1.18) * tint)


LOW_PLANTS: dict[str, PlantGenerator] = {
    build.__name__: partial(fit_to_size, build.__name__, build)
    for build in (grass_tuft, fern, rosette, shrub, dry_bush, moss_cushion)
}
