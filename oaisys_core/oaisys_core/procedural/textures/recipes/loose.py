"""Recipes of loose ground: gravel, sand and its ripples, pebbles, regolith, soil."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.procedural.textures.recipes.finish import (
    Color,
    Recipe,
    TextureMaps,
    blend,
    dusty,
    finish_maps,
    smoothstep,
    stone_bed_maps,
    tint,
)
from oaisys_core.procedural.textures.recipes.stones import StoneBed, StoneSpec

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


def gravel(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Broken stones of 1 to 20 cm on grit, dust between them."""
    return _crush_stones(size_px, rng, (0.52, 0.45, 0.36), GRAVEL_STONES)


def gravel_dark(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Broken volcanic stones on black grit."""
    return _crush_stones(size_px, rng, (0.31, 0.285, 0.265), VOLCANIC_STONES)


def _crush_stones(
    size_px: int, rng: np.random.Generator, grit: Color, stones: tuple[Color, ...]
) -> TextureMaps:
    """Return stones of 1 to 20 cm on grit of one colour."""
    swell = fields.tile_noise(size_px, 3, rng, 2.2)
    color = dusty(size_px, rng, grit, 0.07)
    bed = StoneBed(0.0015 * swell + 0.0004 * fields.grains(size_px, rng, 1.0))
    crowded = np.clip(0.75 + 0.3 * fields.tile_noise(size_px, 4, rng), 0.25, 1)
    bed.add_stones(StoneSpec(21000, (0.0024, 0.007), 2.2, edge=0.06, buried=0.2), rng)
    bed.add_stones(StoneSpec(2600, (0.007, 0.02), 2.2, edge=0.06, buried=0.25), rng, crowded)
    bed.add_stones(
        StoneSpec(260, (0.015, 0.042), 2.0, flatness=0.7, edge=0.05, buried=0.3),
        rng,
        crowded,
    )
    bed.add_stones(StoneSpec(5000, (0.0024, 0.005), 2.2, buried=0.1), rng, crowded)
    return stone_bed_maps(color, bed, stones, rng, roughness=0.86)


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
    patches = fields.tile_noise(size_px, 2, rng)
    ripples = fields.ripples(size_px, (24, 11), rng, bend=0.02)
    ripples *= np.clip(0.6 + 0.4 * patches, 0, 1)
    hummocks = fields.tile_noise(size_px, 5, rng, 2.1)
    grain = fields.grains(size_px, rng, 0.7)
    crumbs = fields.tile_noise(size_px, 40, rng, 1.3)
    height = 0.0005 * ripples + 0.0016 * hummocks + 0.00018 * grain + 0.0003 * crumbs
    color = dusty(size_px, rng, tone, 0.035)
    color *= (1 + 0.02 * patches + 0.015 * hummocks + 0.008 * ripples + 0.045 * crumbs)[..., None]
    bed = StoneBed(height.astype(np.float32))
    gritty = np.clip(0.35 + 0.35 * fields.tile_noise(size_px, 3, rng), 0.06, 1)
    bed.add_stones(StoneSpec(18000, (0.0011, 0.003), 2.2, buried=0.1), rng, gritty)
    bed.add_stones(StoneSpec(3200, (0.003, 0.018), 2.1, edge=0.08, buried=0.2), rng, gritty)
    return stone_bed_maps(color, bed, stones, rng, roughness=0.93)


def rippled_sand(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Sand in wind ripples 10 cm apart: steep lee sides, forks, coarse grains on the crests."""
    phase, amplitude = fields.narrow_band(size_px, 31, rng, (0.06, 0.12))
    swell = fields.tile_noise(size_px, 3, rng, 2.3)
    strength = smoothstep(0.0, 0.45, amplitude) * np.clip(0.9 + 0.12 * swell, 0.4, 1.2)
    wave = np.cos(phase) + 0.20 * np.cos(2 * phase) + 0.24 * np.sin(2 * phase)
    crumbs = fields.tile_noise(size_px, 60, rng, 1.5)
    grain = fields.grains(size_px, rng, 0.7)
    height = 0.00125 * strength * wave + 0.0013 * swell + 0.00007 * crumbs + 0.00006 * grain
    # Wind sorts: coarse, bright grains ride on the crests, dark heavy ones stay in the troughs.
    tone = 1 + 0.07 * strength * wave + 0.045 * grain + 0.03 * crumbs
    tone += 0.03 * fields.tile_noise(size_px, 3, rng)
    color = tint(tone, (0.46, 0.335, 0.215))
    dark = np.clip(fields.tile_noise(size_px, 4, rng) - 0.4 - 0.7 * wave, 0, 1.5) * 0.07
    color = blend(color, (0.20, 0.165, 0.13), dark)
    rough = 0.93 + 0.02 * grain
    return finish_maps(color, height, rough, albedo=0.32, shade=0.35)


def pebbles(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A river's bank: worn pebbles of many kinds of rock, sand between them."""
    swell = fields.tile_noise(size_px, 3, rng, 2.2)
    color = dusty(size_px, rng, (0.50, 0.44, 0.36), 0.06)
    bed = StoneBed(0.0015 * swell + 0.0003 * fields.grains(size_px, rng, 1.0))
    # A stream sorts stones into coarse and fine patches.
    coarse = np.clip(0.6 + 0.45 * fields.tile_noise(size_px, 3, rng, 1.8), 0.05, 1)
    bed.add_stones(StoneSpec(15000, (0.003, 0.008), 2.0, flatness=0.6, edge=0.17, buried=0.2), rng)
    bed.add_stones(
        StoneSpec(4200, (0.008, 0.02), 2.2, flatness=0.6, edge=0.2, buried=0.3), rng, coarse
    )
    bed.add_stones(
        StoneSpec(560, (0.016, 0.036), 2.4, flatness=0.55, edge=0.2, buried=0.35), rng, coarse
    )
    bed.add_stones(StoneSpec(2500, (0.003, 0.006), 2.2, edge=0.15, buried=0.1), rng)
    return stone_bed_maps(color, bed, RIVER_STONES, rng, roughness=0.72)


def regolith(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Grey powder, beaten by small impacts, with clods and angular fragments, as on the Moon."""
    lumps = fields.tile_noise(size_px, 4, rng, 1.9)
    crumbs = fields.tile_noise(size_px, 40, rng, 1.5)
    height = 0.0022 * lumps + 0.00035 * crumbs + 0.00015 * fields.grains(size_px, rng, 0.8)
    height += _small_craters(size_px, rng, 700, (0.004, 0.045))
    color = dusty(size_px, rng, (0.40, 0.39, 0.375), 0.05, hue=0.004)
    color *= (1 + 0.025 * lumps + 0.03 * crumbs)[..., None]
    bed = StoneBed(height.astype(np.float32))
    patchy = np.clip(0.4 + 0.4 * fields.tile_noise(size_px, 3, rng), 0.08, 1)
    bed.add_stones(StoneSpec(20000, (0.0013, 0.004), 2.4, buried=0.2), rng, patchy)
    bed.add_stones(StoneSpec(1700, (0.004, 0.022), 2.2, edge=0.04, buried=0.3), rng, patchy)
    return stone_bed_maps(color, bed, LUNAR_STONES, rng, roughness=0.95)


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
    clods = fields.tile_noise(size_px, 6, rng, 1.8)
    crumbs = fields.tile_noise(size_px, 45, rng, 1.4)
    crust = np.clip(fields.tile_noise(size_px, 3, rng) * 0.8 + 0.2, 0, 1)
    split = fields.cracks(size_px, 14, rng, width=0.05) * crust
    height = 0.0014 * clods + 0.0004 * crumbs * (1 - 0.7 * crust) - 0.0025 * split
    color = dusty(size_px, rng, (0.53, 0.43, 0.33), 0.05)
    color *= (1 + 0.015 * clods + 0.04 * crumbs + 0.06 * crust - 0.3 * split)[..., None]
    bed = StoneBed(height.astype(np.float32))
    stony = np.clip(0.35 + 0.4 * fields.tile_noise(size_px, 4, rng), 0.05, 1)
    bed.add_stones(StoneSpec(16000, (0.0015, 0.004), 2.2, buried=0.15), rng, stony)
    bed.add_stones(StoneSpec(2600, (0.004, 0.02), 2.0, edge=0.07, buried=0.2), rng, stony)
    return stone_bed_maps(color, bed, GRAVEL_STONES, rng, roughness=0.9)


RECIPES: dict[str, Recipe] = {
    "gravel": Recipe(gravel, tile_m=3.2, albedo=(0.1, 0.25), exposure=0.6, has_stones=True),
    "sand": Recipe(sand, tile_m=3.6, albedo=(0.2, 0.35), exposure=-0.8, has_stones=True),
    "rippled_sand": Recipe(rippled_sand, tile_m=3.2, albedo=(0.28, 0.4), exposure=-0.8),
    "red_sand": Recipe(red_sand, tile_m=3.6, albedo=(0.12, 0.25), exposure=-0.8, has_stones=True),
    "gravel_dark": Recipe(
        gravel_dark, tile_m=3.2, albedo=(0.03, 0.1), exposure=0.6, has_stones=True
    ),
    "pebbles": Recipe(pebbles, tile_m=2.2, albedo=(0.1, 0.25), exposure=0.2, has_stones=True),
    "regolith": Recipe(regolith, tile_m=3.4, albedo=(0.08, 0.15), exposure=-0.5, has_stones=True),
    "soil": Recipe(soil, tile_m=3.0, albedo=(0.08, 0.2), exposure=0.2, has_stones=True),
}
