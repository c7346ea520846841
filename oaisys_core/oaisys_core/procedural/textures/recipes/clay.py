"""A dried-up pond: plates of clay between cracks that divided them one after another."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import cells, fields
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.ground import (
    all_at_half,
    at_half,
    fine_noises,
    sky_share,
    swell,
)
from oaisys_core.procedural.textures.baking.sizes import PowerLaw
from oaisys_core.procedural.textures.baking.stamps import cast_rocks
from oaisys_core.procedural.textures.cells import Ids
from oaisys_core.procedural.textures.recipes.finish import (
    BAKED_PX,
    Color,
    Recipe,
    TextureMaps,
    blend,
    linear_to_srgb,
    scale_to_albedo,
    smoothstep,
    tint,
)
from oaisys_core.procedural.textures.recipes.stones import pour
from oaisys_core.types import FloatArray

TILE_M = 2.4
CLAY: Color = (0.335, 0.265, 0.19)
SILT: Color = (0.42, 0.36, 0.28)
INSIDE: Color = (0.12, 0.088, 0.060)
ALBEDO = 0.255

FIRST, DIVISIONS = 3, 7
"""Plates along an edge of the tile between the first cracks, and how often they are divided."""

LEAST_M = (0.13, 0.24)
"""Roots of the areas of plates that are not divided any more."""

BEND = 0.006
"""Standard deviation of cracks from a line, in tile edges."""

SAMPLED = 4
"""Every so many texels along an edge are enough to find the middle and the axes of a plate."""

WIDTHS_M, DEPTHS_M = (0.024, 0.016, 0.008), (0.045, 0.030, 0.016)
"""Widths and depths of cracks of the first, of the middle and of the last divisions, as of clay
that has shrunk by a twelfth."""

RAGGED = 0.12
"""Standard deviation of a crack's edge, relative to half of its width."""

CURL_M, RIM_M = 0.0055, 0.028
"""Height of a plate's rim above its middle, and how far it goes."""

CRUMBS, CRUMBS_M, ON_PLATES = Laying(buried=(0.1, 0.4), makes_room=False), (0.002, 0.008), 0.004
"""How crumbs lie and their diameters, and the probability with which one on a plate stays there."""


def clay_cracks(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A dried-up pond: plates of clay with curled rims, divided by cracks one after another."""
    *rims_m, edge, plate, top_m = all_at_half(size_px, lambda px: _plates(px, rng))
    gap, depth_m = _cracks(rims_m, rng)
    uneven, (grain, fine) = swell(size_px, 7, rng, 2.0), fine_noises(size_px, rng)
    top_m += 0.0022 * uneven + 0.00025 * fine + 0.00006 * grain
    bed = Bed((top_m * (1 - gap) - depth_m * gap) / np.float32(TILE_M))
    inside = np.clip(gap, ON_PLATES, 1)
    pour(bed, TILE_M, cast_rocks("angular"), PowerLaw(2.2), 0.6, CRUMBS_M, CRUMBS, rng, inside)
    tone = 1 + 0.05 * plate + 0.03 * fine + 0.03 * grain + 0.05 * swell(size_px, 3, rng)
    color = tint(tone + 0.07 * edge, CLAY)
    color = blend(color, SILT, 0.3 * smoothstep(0.2, 1.6, uneven) * (1 - edge))
    color = blend(color, INSIDE, gap * np.where(bed.ids >= 0, np.float32(0.4), np.float32(0.9)))
    color *= sky_share(bed.height, (0.003 / TILE_M, 0.012 / TILE_M))[..., None]
    scale_to_albedo(color, ALBEDO)
    rough = np.clip(0.9 + 0.02 * grain, 0, 1).astype(np.float32)
    return TextureMaps(linear_to_srgb(color), bed.height, rough)


def _plates(size_px: int, rng: np.random.Generator) -> tuple[Field, ...]:
    """Return (N, N) distances in metres to cracks of each age, and of the plates between all.

    The last three are how near their rims are, 0 to 1, a random number of each plate, and their
    heights in metres.
    """
    ages = divide(size_px, rng)
    rims_m = [TILE_M / len(ids) * cells.border_distance(ids) for ids in ages]
    edge = np.exp(np.float32(-1 / RIM_M) * rims_m[-1])
    plate = cells.per_cell(ages[-1], rng)
    top_m = CURL_M * edge * np.clip(1 + 0.5 * cells.per_cell(ages[-1], rng), 0.2, 2)
    top_m += 0.0012 * plate + 0.010 * TILE_M * cells.facet_heights(ages[-1], rng)
    return (*rims_m, edge, plate, top_m)


def divide(part_px: int, rng: np.random.Generator) -> list[Ids]:
    """Return the (M, M) plates between the first, the first half and all of the cracks.

    A crack runs across a plate near its middle and meets older ones at right angles (S. Bohn, L.
    Pauchard and Y. Couder, "Hierarchical crack pattern as formed by successive domain divisions",
    Phys. Rev. E 71, 2005).
    """
    ids = cells.voronoi(part_px, FIRST, rng, warp=0.05, jitter=0.40, smooth=2.6)
    bends = [BEND * fields.tile_noise(part_px, 7, rng, 2.5) for _ in range(2)]
    least = rng.uniform(*LEAST_M, FIRST**2 * 2**DIVISIONS) / TILE_M
    ages = [ids]
    for number in range(DIVISIONS):
        ids = halve(ids, bends, least, rng)
        if number in (DIVISIONS // 2 - 1, DIVISIONS - 1):
            ages.append(ids)
    return ages


def halve(ids: Ids, bends: list[Field], least: FloatArray, rng: np.random.Generator) -> Ids:
    """Return the ids after a crack across each plate that is wider than its least size."""
    sample = np.ascontiguousarray(ids[::SAMPLED, ::SAMPLED])
    x, y = cells.from_centre(sample)
    count = int(ids.max()) + 1
    number = np.maximum(np.bincount(sample.ravel(), minlength=count), 1)
    xx, xy, yy = (
        np.bincount(sample.ravel(), (one * two).ravel(), count) / number
        for one, two in ((x, x), (x, y), (y, y))
    )
    # Across the longer axis of the plate.
    angle = 0.5 * np.arctan2(2 * xy, xx - yy) + rng.normal(0, 0.15, count)
    width = np.sqrt(number) / len(sample)
    aside = rng.normal(0, 0.06, count) * width
    aside[width <= least[:count]] = np.inf
    x, y = cells.from_centre(ids, SAMPLED)
    cos, sin, from_middle = (
        each.astype(np.float32)[ids] for each in (np.cos(angle), np.sin(angle), aside)
    )
    halves = 2 * ids + (cos * (x + bends[0]) + sin * (y + bends[1]) > from_middle)
    used = np.bincount(halves.ravel(), minlength=2 * count) > 0
    return np.asarray((np.cumsum(used) - 1)[halves], np.int64)


def _cracks(rims_m: list[Field], rng: np.random.Generator) -> tuple[Field, Field]:
    """Return (N, N) shares of cracks, 0 to 1, and their depth in metres.

    Args:
        rims_m: Distances to cracks of each age.
        rng: Draws how wide they are along their way.
    """
    size_px = len(rims_m[0])
    ragged = at_half(size_px, lambda half_px: fields.tile_noise(half_px, 60, rng, 1.7))
    wander = np.clip(1 + 0.35 * swell(size_px, 9, rng, 1.8), 0.4, 2)
    gap, depth = np.zeros((2, size_px, size_px), np.float32)
    for rim_m, width_m, depth_m in zip(rims_m, WIDTHS_M, DEPTHS_M, strict=True):
        beside = rim_m - np.float32(width_m / 2) * (wander + RAGGED * ragged)
        gap = np.maximum(gap, smoothstep(0.0012, -0.0012, beside))
        # The walls are steep, and the floor is round.
        depth = np.maximum(depth, depth_m * smoothstep(0.001, -0.5 * width_m, beside))
    return gap, depth


RECIPES: dict[str, Recipe] = {
    "clay_cracks": Recipe(
        clay_cracks, TILE_M, albedo=(0.2, 0.35), exposure=-0.6, stands_out=True, size_px=BAKED_PX
    ),
}
