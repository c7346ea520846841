"""Recipes of loose ground: gravel, sand, regolith, soil."""

from __future__ import annotations

import numpy as np

from oaisys_core.textures import fields
from oaisys_core.textures.stones import Bed, Pour
from oaisys_core.textures.surface import Color, Recipe, Surface, covered, dusty

GRAVEL_STONES: tuple[Color, ...] = (
    (0.56, 0.49, 0.41),
    (0.61, 0.54, 0.45),
    (0.50, 0.45, 0.39),
    (0.66, 0.60, 0.51),
    (0.52, 0.43, 0.35),
    (0.57, 0.54, 0.50),
    (0.45, 0.41, 0.37),
)
LUNAR_STONES: tuple[Color, ...] = (
    (0.42, 0.41, 0.40),
    (0.48, 0.47, 0.45),
    (0.37, 0.36, 0.35),
)


def gravel(size_px: int, rng: np.random.Generator) -> Surface:
    """Broken stones of 1 to 20 cm on grit, dust between them."""
    swell = fields.tile_noise(size_px, 3, rng, 2.2)
    color = dusty(size_px, rng, (0.52, 0.45, 0.36), 0.07)
    bed = Bed(0.0015 * swell + 0.0004 * fields.grains(size_px, rng, 1.0))
    crowded = np.clip(0.75 + 0.3 * fields.tile_noise(size_px, 4, rng), 0.25, 1)
    bed.pour(Pour(21000, (0.0024, 0.007), 2.2, edge=0.06, buried=0.2), rng)
    bed.pour(Pour(2600, (0.007, 0.02), 2.2, edge=0.06, buried=0.25), rng, crowded)
    bed.pour(
        Pour(260, (0.015, 0.042), 2.0, flatness=0.7, edge=0.05, buried=0.3),
        rng,
        crowded,
    )
    bed.pour(Pour(5000, (0.0024, 0.005), 2.2, buried=0.1), rng, crowded)
    return covered(color, bed, GRAVEL_STONES, rng, roughness=0.86)


def sand(size_px: int, rng: np.random.Generator) -> Surface:
    """Wind-blown sand: faint ripples, hummocks, grit and pebbles in patches."""
    patches = fields.tile_noise(size_px, 2, rng)
    ripples = fields.ripples(size_px, (24, 11), rng, bend=0.02)
    ripples *= np.clip(0.6 + 0.4 * patches, 0, 1)
    hummocks = fields.tile_noise(size_px, 5, rng, 2.1)
    grain = fields.grains(size_px, rng, 0.7)
    crumbs = fields.tile_noise(size_px, 40, rng, 1.3)
    height = 0.0005 * ripples + 0.0016 * hummocks + 0.00018 * grain + 0.0003 * crumbs
    color = dusty(size_px, rng, (0.64, 0.54, 0.41), 0.035)
    color *= (1 + 0.02 * patches + 0.015 * hummocks + 0.008 * ripples + 0.045 * crumbs)[..., None]
    bed = Bed(height.astype(np.float32))
    gritty = np.clip(0.35 + 0.35 * fields.tile_noise(size_px, 3, rng), 0.06, 1)
    bed.pour(Pour(18000, (0.0011, 0.003), 2.2, buried=0.1), rng, gritty)
    bed.pour(Pour(3200, (0.003, 0.018), 2.1, edge=0.08, buried=0.2), rng, gritty)
    # Without the darkest stones: a few of them in plain sand would show that it repeats.
    return covered(color, bed, GRAVEL_STONES[:5], rng, roughness=0.93)


def regolith(size_px: int, rng: np.random.Generator) -> Surface:
    """Grey powder with clods and angular fragments, as on the Moon."""
    lumps = fields.tile_noise(size_px, 4, rng, 1.9)
    crumbs = fields.tile_noise(size_px, 40, rng, 1.5)
    height = 0.0022 * lumps + 0.0003 * crumbs + 0.00015 * fields.grains(size_px, rng, 0.8)
    color = dusty(size_px, rng, (0.43, 0.42, 0.40), 0.05)
    color *= (1 + 0.025 * lumps + 0.03 * crumbs)[..., None]
    bed = Bed(height.astype(np.float32))
    patchy = np.clip(0.4 + 0.4 * fields.tile_noise(size_px, 3, rng), 0.08, 1)
    bed.pour(Pour(16000, (0.0013, 0.004), 2.4, buried=0.2), rng, patchy)
    bed.pour(Pour(1700, (0.004, 0.022), 2.2, edge=0.04, buried=0.3), rng, patchy)
    return covered(color, bed, LUNAR_STONES, rng, roughness=0.95)


def soil(size_px: int, rng: np.random.Generator) -> Surface:
    """Dry, crusted earth: crumbs, hairline cracks, small stones."""
    clods = fields.tile_noise(size_px, 6, rng, 1.8)
    crumbs = fields.tile_noise(size_px, 45, rng, 1.4)
    crust = np.clip(fields.tile_noise(size_px, 3, rng) * 0.8 + 0.2, 0, 1)
    split = fields.cracks(size_px, 14, rng, width=0.05) * crust
    height = 0.0014 * clods + 0.0004 * crumbs * (1 - 0.7 * crust) - 0.0025 * split
    color = dusty(size_px, rng, (0.53, 0.43, 0.33), 0.05)
    color *= (1 + 0.015 * clods + 0.04 * crumbs + 0.06 * crust - 0.3 * split)[..., None]
    bed = Bed(height.astype(np.float32))
    stony = np.clip(0.35 + 0.4 * fields.tile_noise(size_px, 4, rng), 0.05, 1)
    bed.pour(Pour(16000, (0.0015, 0.004), 2.2, buried=0.15), rng, stony)
    bed.pour(Pour(2600, (0.004, 0.02), 2.0, edge=0.07, buried=0.2), rng, stony)
    return covered(color, bed, GRAVEL_STONES, rng, roughness=0.9)


RECIPES: dict[str, Recipe] = {
    "gravel": Recipe(gravel, tile_m=3.2, version=5, albedo=(0.1, 0.25)),
    "sand": Recipe(sand, tile_m=3.6, version=5, albedo=(0.2, 0.35)),
    "regolith": Recipe(regolith, tile_m=3.4, version=5, albedo=(0.08, 0.16)),
    "soil": Recipe(soil, tile_m=3.0, version=5, albedo=(0.08, 0.2)),
}
