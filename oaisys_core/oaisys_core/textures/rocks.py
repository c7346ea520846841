"""Recipes of bare rock."""

from __future__ import annotations

import numpy as np

from oaisys_core.textures import fields
from oaisys_core.textures.surface import Color, Recipe, Surface, dusty, lit


def rock(size_px: int, rng: np.random.Generator) -> Surface:
    """Weathered, brown sandstone."""
    return _weathered(size_px, rng, (0.55, 0.48, 0.40))


def basalt(size_px: int, rng: np.random.Generator) -> Surface:
    """Dark grey rock, to lie on regolith."""
    return _weathered(size_px, rng, (0.40, 0.39, 0.38))


def _weathered(size_px: int, rng: np.random.Generator, tone: Color) -> Surface:
    """Return bare rock: faint layers, broken steps, pits, cracks, stains."""
    layers = fields.strata(size_px, 22, rng)
    mass = fields.tile_noise(size_px, 4, rng, 1.9)
    rough = fields.tile_noise(size_px, 14, rng, 1.7)
    steps = fields.crests(size_px, 5, rng)
    grain = fields.grains(size_px, rng, 0.8)
    # A crack runs only where the rock is weak, so that it ends somewhere.
    weak = np.clip(1.5 * fields.tile_noise(size_px, 2, rng, 2.2) - 0.2, 0, 1)
    split = weak * fields.cracks(size_px, 6, rng, width=0.022)
    pits = np.clip(fields.tile_noise(size_px, 45, rng, 1.7) - 1.6, 0, 1.5)
    height = 0.005 * layers + 0.005 * mass + 0.0011 * rough + 0.010 * steps
    height += 0.0002 * grain - 0.006 * split - 0.002 * pits
    color = dusty(size_px, rng, tone, 0.05)
    color *= (1 + 0.05 * layers + 0.055 * rough + 0.16 * (steps - 0.6) - 0.3 * split)[..., None]
    stain = fields.tile_noise(size_px, 3, rng)[..., None]
    color *= 1 + 0.025 * stain * np.array((1.0, 0.4, -0.3), np.float32)
    color *= (1 - 0.18 * np.clip(pits, 0, 1))[..., None]
    return lit(color, height.astype(np.float32), rng, roughness=0.87)


RECIPES: dict[str, Recipe] = {
    "rock": Recipe(rock, tile_m=2.0, version=5, albedo=(0.1, 0.25)),
    "basalt": Recipe(basalt, tile_m=2.0, version=5, albedo=(0.05, 0.15)),
}
