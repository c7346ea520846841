"""Recipes of loose ground: gravel, sand, pebbles, regolith, soil."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.ground import at_half, grit, swell
from oaisys_core.procedural.textures.baking.sizes import PowerLaw, RosinRammler
from oaisys_core.procedural.textures.baking.stamps import cast_rocks
from oaisys_core.procedural.textures.recipes.finish import (
    BAKED_PX,
    Color,
    Recipe,
    TextureMaps,
)
from oaisys_core.procedural.textures.recipes.stones import StoneBed, pour, stone_maps

GRAVEL_STONES: tuple[Color, ...] = (
    (0.56, 0.49, 0.41),
    (0.61, 0.54, 0.45),
    (0.50, 0.45, 0.39),
    (0.66, 0.60, 0.51),
    (0.52, 0.43, 0.35),
    (0.57, 0.54, 0.50),
    (0.45, 0.41, 0.37),
)
VOLCANIC_STONES: tuple[Color, ...] = (
    (0.28, 0.27, 0.26),
    (0.33, 0.31, 0.29),
    (0.24, 0.235, 0.23),
    (0.37, 0.33, 0.30),
    (0.30, 0.26, 0.235),
)
RUSTY_STONES: tuple[Color, ...] = (
    (0.50, 0.38, 0.29),
    (0.44, 0.35, 0.29),
    (0.55, 0.42, 0.32),
    (0.40, 0.33, 0.285),
)
RIVER_STONES: tuple[Color, ...] = (
    (0.52, 0.50, 0.47),
    (0.45, 0.44, 0.43),
    (0.58, 0.53, 0.46),
    (0.64, 0.61, 0.56),
    (0.40, 0.39, 0.40),
    (0.50, 0.42, 0.36),
    (0.56, 0.47, 0.40),
    (0.34, 0.335, 0.34),
    (0.46, 0.47, 0.44),
    (0.67, 0.65, 0.61),
)
LUNAR_STONES: tuple[Color, ...] = (
    (0.42, 0.41, 0.40),
    (0.46, 0.45, 0.435),
    (0.37, 0.36, 0.35),
)


GRAVEL_M, PEBBLES_M, SAND_M, REGOLITH_M, SOIL_M = 2.8, 2.2, 3.6, 2.8, 2.8
"""Edge lengths of the tiles."""

LOOSE = Laying(buried=(0.0, 0.25))
"""Stones that lie open."""

MIXED = Laying(buried=(0.0, 0.5))
"""Stones of which some lie open, and fines have come around others."""

SUNK = Laying(buried=(0.2, 0.6))
"""Stones that fines have come around."""


def gravel(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Broken stones of 6 mm to 15 cm, sunk into grit and dust."""
    return _crush_stones(size_px, rng, (0.52, 0.45, 0.36), GRAVEL_STONES)


def gravel_dark(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Broken volcanic stones on black grit."""
    return _crush_stones(size_px, rng, (0.31, 0.285, 0.265), VOLCANIC_STONES)


def _crush_stones(
    size_px: int, rng: np.random.Generator, dust: Color, stones: tuple[Color, ...]
) -> TextureMaps:
    """Return broken stones on grit of one colour.

    A law of exponent 0.9 and 35 mm has stones up to 15 cm, and half of their area below 25 mm.
    """
    law, tile_m = RosinRammler(0.035, 0.9), GRAVEL_M
    crowded = np.clip(0.7 + 0.35 * swell(size_px, 4, rng), 0.15, 1)
    ground = _gritty(size_px, rng, tile_m, dust, height_m=0.007, cover=0.55)
    bed = Bed(ground.height)
    angular = cast_rocks("angular")
    pour(bed, tile_m, angular, law, 0.85, (0.006, 0.15), MIXED, rng, crowded)
    pour(bed, tile_m, angular, law, 0.08, (0.005, 0.03), LOOSE, rng, crowded)
    return stone_maps(ground, bed, tile_m, stones, rng, roughness=0.86)


def _gritty(
    size_px: int,
    rng: np.random.Generator,
    tile_m: float,
    dust: Color,
    *,
    height_m: float,
    cover: float,
) -> StoneBed:
    """Return swells of a standard deviation with grit of 2 to 6 mm on them."""
    high = swell(size_px, 3, rng, 2.2) * np.float32(height_m / tile_m)
    stones = grit(
        size_px, cast_rocks("angular"), PowerLaw(2.0), cover, (0.002 / tile_m, 0.006 / tile_m), rng
    )
    high += stones.height
    return StoneBed(high, 1 + 0.13 * stones.tone, dust)


def sand(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Wind-blown sand: faint ripples, hummocks, grit and pebbles in patches."""
    # Without the darkest stones, which would make the repetition of plain sand visible.
    return _gritty_sand(size_px, rng, (0.64, 0.54, 0.41), GRAVEL_STONES[:5])


def red_sand(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Sand under the rust-coloured dust of Mars, with dusty pebbles."""
    return _gritty_sand(size_px, rng, (0.575, 0.445, 0.345), RUSTY_STONES)


def _gritty_sand(
    size_px: int, rng: np.random.Generator, tone: Color, stones: tuple[Color, ...]
) -> TextureMaps:
    """Return sand of one colour with grit and pebbles in patches."""
    patches = swell(size_px, 2, rng)
    ripples = fields.ripples(size_px, (24, 11), rng, bend=0.02)
    ripples *= np.clip(0.6 + 0.4 * patches, 0, 1)
    hummocks = swell(size_px, 5, rng, 2.1)
    crumbs = fields.tile_noise(size_px, 40, rng, 1.3)
    height = 0.0005 * ripples + 0.0016 * hummocks + 0.0003 * crumbs
    shade = 1 + 0.02 * patches + 0.015 * hummocks + 0.008 * ripples + 0.045 * crumbs
    bed = Bed(height)
    gritty = np.clip(0.35 + 0.35 * swell(size_px, 3, rng), 0.06, 1)
    pour(
        bed,
        SAND_M,
        cast_rocks("rounded"),
        RosinRammler(0.03, 0.8),
        0.05,
        (0.008, 0.06),
        SUNK,
        rng,
        gritty,
    )
    pour(bed, SAND_M, cast_rocks("angular"), PowerLaw(2.2), 0.07, (0.003, 0.01), LOOSE, rng, gritty)
    return stone_maps(StoneBed(height, shade, tone), bed, SAND_M, stones, rng, roughness=0.93)


def pebbles(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A river's bank: worn pebbles of many kinds of rock, sand between them.

    An exponent of 1.6 is that of gravel which a stream has sorted.
    """
    law, tile_m = RosinRammler(0.034, 1.6), PEBBLES_M
    # A stream sorts stones into coarse and fine patches.
    coarse = np.clip(0.9 + 0.45 * swell(size_px, 3, rng, 1.8), 0.25, 1)
    ground = _gritty(size_px, rng, tile_m, (0.47, 0.43, 0.37), height_m=0.005, cover=0.6)
    bed = Bed(ground.height)
    worn, few = cast_rocks("pebble"), cast_rocks("rounded")
    flat = Laying(flatness=0.8, buried=(0.2, 0.5))
    pour(bed, tile_m, few, law, 0.25, (0.012, 0.1), flat, rng, coarse)
    pour(bed, tile_m, worn, law, 0.9, (0.007, 0.09), flat, rng, coarse)
    pour(bed, tile_m, worn, law, 0.12, (0.005, 0.03), LOOSE, rng)
    return stone_maps(ground, bed, tile_m, RIVER_STONES, rng, roughness=0.72)


def regolith(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Grey powder, beaten by small impacts, with clods and angular fragments, as on the Moon."""
    tile_m = REGOLITH_M
    lumps = swell(size_px, 4, rng, 1.9)
    crumbs = at_half(size_px, lambda px: fields.tile_noise(px, 40, rng, 1.5))
    height = 0.0022 * lumps + 0.0004 * crumbs
    height += at_half(size_px, lambda px: _small_craters(px, rng, 700, (0.004, 0.05)))
    clods = Bed(height)
    # Impacts weld powder to clods of its own colour.
    pour(clods, tile_m, cast_rocks("boulder"), PowerLaw(2.3), 0.2, (0.003, 0.05), SUNK, rng)
    shade = 1 + 0.025 * lumps + 0.03 * crumbs + 0.04 * (clods.ids % 5 - 2) * (clods.ids >= 0)
    ground = StoneBed(fields.blur(clods.height, 0.8), shade, (0.40, 0.39, 0.375))
    bed = Bed(ground.height)
    patchy = np.clip(0.4 + 0.4 * swell(size_px, 3, rng), 0.08, 1)
    pour(bed, tile_m, cast_rocks("angular"), PowerLaw(2.1), 0.08, (0.004, 0.09), SUNK, rng, patchy)
    return stone_maps(ground, bed, tile_m, LUNAR_STONES, rng, roughness=0.95)


def _small_craters(
    size_px: int, rng: np.random.Generator, number: int, radius: tuple[float, float]
) -> Field:
    """Return (N, N) heights, in tile edges, of bowls with raised rims, most of them worn down."""
    centres, radii = fields.spread(size_px, number, radius, 2.0, rng)
    fresh = rng.uniform(size=len(radii)) ** 2 * 0.9 + 0.1
    height = np.zeros((size_px, size_px), np.float32)
    for (row, column), r, depth in zip(centres, radii, 0.33 * fresh * radii / size_px, strict=True):
        reach = min(int(np.ceil(2.5 * r)), size_px // 2 - 1)
        offset = np.arange(-reach, reach + 1)
        rows, columns = int(row) + offset, int(column) + offset
        away = np.hypot((rows + 0.5 - row)[:, None], (columns + 0.5 - column)[None, :]) / r
        bowl = np.where(away < 1, 1.25 * away**2 - 1, 0.25 / np.maximum(away, 1) ** 3)
        fade = np.clip((2.5 - away) / 1.0, 0, 1)
        height[np.ix_(rows % size_px, columns % size_px)] += (depth * bowl * fade).astype(
            np.float32
        )
    return height


def soil(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Dry, crusted earth: crumbs, hairline cracks, small stones."""
    tile_m = SOIL_M
    rolling = swell(size_px, 6, rng, 1.8)
    crust = np.clip(swell(size_px, 3, rng) * 0.8 + 0.2, 0, 1)
    split = at_half(size_px, lambda px: fields.cracks(px, 14, rng, width=0.05)) * crust
    height = 0.0014 * rolling - 0.0025 * split
    crumbs = Bed(height)
    loose = np.clip(1 - 0.8 * crust, 0.1, 1)
    law = RosinRammler(0.012, 0.9)
    pour(crumbs, tile_m, cast_rocks("boulder"), law, 0.7, (0.005, 0.05), SUNK, rng, loose)
    shade = 1 + 0.015 * rolling + 0.06 * crust - 0.3 * split
    shade += 0.05 * (crumbs.ids % 5 - 2) * (crumbs.ids >= 0)
    ground = StoneBed(fields.blur(crumbs.height, 0.7), shade, (0.53, 0.43, 0.33))
    bed = Bed(ground.height)
    stony = np.clip(0.35 + 0.4 * swell(size_px, 4, rng), 0.05, 1)
    few = RosinRammler(0.02, 0.8)
    pour(bed, tile_m, cast_rocks("angular"), few, 0.1, (0.004, 0.08), SUNK, rng, stony)
    return stone_maps(ground, bed, tile_m, GRAVEL_STONES, rng, roughness=0.9)


def _stony(
    make: Callable[[int, np.random.Generator], TextureMaps],
    tile_m: float,
    albedo: tuple[float, float],
    exposure: float,
) -> Recipe:
    return Recipe(make, tile_m, albedo, exposure=exposure, has_stones=True, size_px=BAKED_PX)


RECIPES: dict[str, Recipe] = {
    "gravel": _stony(gravel, GRAVEL_M, (0.1, 0.25), 0.6),
    "sand": _stony(sand, SAND_M, (0.2, 0.35), -0.8),
    "red_sand": _stony(red_sand, SAND_M, (0.12, 0.25), -0.8),
    "gravel_dark": _stony(gravel_dark, GRAVEL_M, (0.03, 0.1), 0.6),
    "pebbles": _stony(pebbles, PEBBLES_M, (0.1, 0.25), 0.2),
    "regolith": _stony(regolith, REGOLITH_M, (0.08, 0.15), -0.5)._replace(stands_out=True),
    "soil": _stony(soil, SOIL_M, (0.08, 0.2), 0.2),
}
