"""Recipes of frozen ground: snow, ice."""

from __future__ import annotations

import numpy as np

from oaisys_core.terrain.noise import Field
from oaisys_core.textures import cells, fields
from oaisys_core.textures.surface import Recipe, Surface, blended, finished, smoothstep, tinted


def snow(size_px: int, rng: np.random.Generator) -> Surface:
    """Wind-packed snow: soft drifts, low sastrugi where wind cut layers away, a grainy crust."""
    drift = fields.windblown(size_px, rng, (3.0, 5.0), 2.3)
    ridges = fields.windblown(size_px, rng, (5.0, 16.0), 2.1)
    flutes = fields.windblown(size_px, rng, (12.0, 50.0), 1.8)
    crumbs = fields.tile_noise(size_px, 60, rng, 1.5)
    grain = fields.grains(size_px, rng, 0.9)
    eroded = smoothstep(-1.2, 1.6, drift + 0.5 * ridges)
    layer = ridges + 0.25 * flutes
    cut = smoothstep(0.0, 0.9, layer) + 0.6 * smoothstep(1.2, 1.9, layer)
    height = 0.0030 * drift + 0.0011 * ridges + eroded * (0.0016 * cut + 0.00022 * flutes)
    height += 0.00010 * crumbs + 0.00005 * grain
    tone = 1 + 0.006 * grain + 0.006 * crumbs + 0.008 * drift
    color = tinted(tone, (0.80, 0.815, 0.83))
    glazed = eroded * smoothstep(0.1, 1.0, layer)
    color = blended(color, (0.735, 0.765, 0.795), 0.35 * glazed)
    rough = 0.85 - 0.2 * glazed + 0.02 * grain
    return finished(color, height, rough, albedo=0.80, shade=0.2)


def ice(size_px: int, rng: np.random.Generator) -> Surface:
    """Lake ice: clear and milky parts, healed fractures, flocks of bubbles, a trace of snow."""
    milk = fields.tile_noise(size_px, 3, rng, 2.3)
    fine = fields.tile_noise(size_px, 30, rng, 1.5)
    milk = smoothstep(-2.4, 3.2, milk + 0.18 * fine)
    color = blended(tinted(1 + 0.03 * fine, (0.15, 0.235, 0.265)), (0.42, 0.52, 0.55), milk)
    white = np.zeros((size_px, size_px), np.float32)
    split = np.zeros((size_px, size_px), np.float32)
    for count, depth, strength in ((3, 0.09, 0.75), (5, 0.06, 0.65), (11, 0.022, 0.45)):
        sheet, line = _fractures(size_px, count, depth, rng)
        white = np.maximum(white, strength * sheet)
        split = np.maximum(split, line * (0.35 + strength))
    white = np.maximum(white, 0.9 * split)
    flock = np.clip(0.1 + 0.5 * fields.tile_noise(size_px, 5, rng, 1.6), 0.01, 1)
    for strength in (0.25, 0.45, 0.75):
        bubbles = fields.spread(size_px, 2600, (0.0008, 0.005), 2.2, rng, flock)
        white = np.maximum(white, strength * smoothstep(0.0, 1.0, fields.domes(size_px, *bubbles)))
    color = blended(color, (0.74, 0.79, 0.81), white)
    scour = fields.windblown(size_px, rng, (7.0, 11.0), 2.4)
    grain = fields.grains(size_px, rng, 0.8)
    # Snow stays in the hollows of the scoured surface, thin and with ragged edges.
    dust = smoothstep(0.8, 3.4, -scour + 0.6 * fine + 0.35 * grain) * 0.75
    color = blended(color, (0.83, 0.85, 0.87), dust)
    height = 0.0011 * scour - 0.0006 * split + 0.00005 * fine + 0.0003 * dust
    height += (0.00001 + 0.00006 * dust) * grain
    rough = 0.09 + 0.05 * milk + 0.3 * split + 0.7 * dust + 0.015 * fine
    return finished(color, height, np.clip(rough, 0.04, 0.9), albedo=0.33, shade=0.1)


def _fractures(
    size_px: int, count: int, depth: float, rng: np.random.Generator
) -> tuple[Field, Field]:
    """Return (N, N) of healed fractures: the white sheet that dips into the ice, and its line.

    A fracture leans to one side, and seen through the ice it fades with depth.
    """
    ids = cells.voronoi(size_px, count, rng, warp=0.07, jitter=0.48, smooth=2.9)
    present = fields.tile_noise(size_px, 2 + count // 3, rng, 2.4) > -0.4
    distance = cells.border_distance(ids, present) / np.float32(size_px)
    leaning = rng.uniform(size=int(ids.max()) + 1).astype(np.float32)[ids]
    streaks = 0.65 + 0.35 * fields.tile_noise(size_px, 18, rng, 1.4)
    reach = depth * (0.1 + leaning) * (1 + 0.3 * streaks)
    sheet = np.square(np.clip(1 - distance / reach, 0, 1)) * (leaning > 0.4) * streaks
    line = smoothstep(0.0014, 0.0003, distance)
    return np.clip(sheet, 0, 1).astype(np.float32), line


RECIPES: dict[str, Recipe] = {
    "snow": Recipe(snow, tile_m=4.0, version=1, albedo=(0.72, 0.88)),
    "ice": Recipe(ice, tile_m=3.0, version=1, albedo=(0.25, 0.45)),
}
