"""The recipe of lake ice."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import cells, fields
from oaisys_core.procedural.textures.recipes.finish import (
    Recipe,
    TextureMaps,
    blend,
    finish_maps,
    smoothstep,
    tint,
)


def ice(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Clear lake ice: dark, with healed fractures, flocks of bubbles and a trace of snow."""
    milk = smoothstep(-2.5, 5.0, fields.tile_noise(size_px, 3, rng, 2.2))
    fine = fields.tile_noise(size_px, 40, rng, 1.6)
    color = tint(1 + 0.04 * fine, (0.112, 0.160, 0.171))
    color = blend(color, (0.31, 0.37, 0.378), milk)
    white = np.zeros((size_px, size_px), np.float32)
    split = np.zeros((size_px, size_px), np.float32)
    for count, depth, strength in ((4, 0.055, 0.65), (7, 0.03, 0.5), (14, 0.012, 0.35)):
        sheet, line = _fractures(size_px, count, depth, rng)
        white = np.maximum(white, strength * sheet)
        split = np.maximum(split, line * (0.2 + strength))
    white = np.maximum(white, 0.85 * np.clip(split, 0, 1))
    flock = np.clip(0.05 + 0.45 * fields.tile_noise(size_px, 6, rng, 1.5), 0.01, 1)
    for strength in (0.2, 0.35, 0.6):
        bubbles = fields.spread(size_px, 3600, (0.0008, 0.0045), 2.2, rng, flock)
        white = np.maximum(white, strength * smoothstep(0.0, 1.0, fields.domes(size_px, *bubbles)))
    color = blend(color, (0.70, 0.76, 0.775), white)
    scour = fields.windblown(size_px, rng, (7.0, 9.0), 2.5)
    grain = fields.grains(size_px, rng, 0.9)
    # A film of snow remains where the surface is low and along open cracks.
    film = smoothstep(1.2, 3.6, 0.8 * fine + 0.8 * grain - 0.8 * scour)
    color = blend(color, (0.80, 0.82, 0.84), 0.55 * film)
    height = 0.0007 * scour - 0.0006 * split + 0.00004 * fine + 0.0001 * film
    rough = 0.08 + 0.06 * milk + 0.3 * split + 0.6 * film + 0.01 * fine
    return finish_maps(color, height, np.clip(rough, 0.04, 0.9), albedo=0.23, shade=0.1)


def _fractures(
    size_px: int, count: int, depth: float, rng: np.random.Generator
) -> tuple[Field, Field]:
    """Return (N, N) of healed fractures: the white sheet that dips into the ice, and its line.

    A fracture leans to one side; seen through the ice, it fades with depth.
    """
    ids = cells.voronoi(size_px, count, rng, warp=0.04, jitter=0.48, smooth=2.9)
    present = fields.tile_noise(size_px, 2 + count // 3, rng, 2.4) > -0.5
    distance = cells.border_distance(ids, present) / np.float32(size_px)
    leaning = rng.uniform(size=int(ids.max()) + 1).astype(np.float32)[ids]
    streaks = np.clip(0.6 + 0.3 * fields.tile_noise(size_px, 12, rng, 1.5), 0.1, 1)
    reach = depth * (leaning - 0.35) * (0.4 + streaks)
    sheet = np.square(np.clip(1 - distance / np.maximum(reach, 1e-6), 0, 1)) * streaks
    line = smoothstep(0.0015, 0.0004, distance)
    return np.asarray(sheet, np.float32), line


RECIPES: dict[str, Recipe] = {
    "ice": Recipe(
        ice, tile_m=3.6, albedo=(0.15, 0.35), subsurface=0.6, exposure=-0.6, stands_out=True
    ),
}
