"""Recipes of frozen ground: snow, ice."""

from __future__ import annotations

import numpy as np
import scipy

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


def snow(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Wind-packed snow: soft drifts, low sastrugi where wind cut layers away, a grainy crust."""
    drift = fields.windblown(size_px, rng, (3.0, 4.5), 2.4)
    ridges = fields.windblown(size_px, rng, (5.0, 11.0), 2.2)
    flutes = fields.windblown(size_px, rng, (14.0, 40.0), 1.8)
    crumbs = fields.tile_noise(size_px, 60, rng, 1.5)
    grain = fields.grains(size_px, rng, 0.9)
    eroded = smoothstep(-0.6, 1.8, drift + 0.5 * ridges)
    layer = ridges + 0.25 * flutes
    cut = smoothstep(0.0, 0.6, layer) + 0.7 * smoothstep(1.1, 1.6, layer)
    height = 0.0034 * drift + 0.0013 * ridges + eroded * (0.0020 * cut + 0.0002 * flutes)
    height += 0.00010 * crumbs + 0.00005 * grain
    tone = 1 + 0.006 * grain + 0.006 * crumbs + 0.008 * drift
    color = tint(tone, (0.80, 0.815, 0.83))
    glazed = eroded * smoothstep(0.1, 1.0, layer)
    color = blend(color, (0.735, 0.765, 0.795), 0.35 * glazed)
    rough = 0.85 - 0.2 * glazed + 0.02 * grain
    return finish_maps(color, height, rough, albedo=0.80, shade=0.2)


def sastrugi(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Sastrugi: ridges of old snow that the wind has carved, steep towards it, with long tails."""
    ridge = fields.windblown(size_px, rng, (2.5, 9.0), 2.3)
    flutes = fields.windblown(size_px, rng, (9.0, 42.0), 1.9)
    drift = fields.windblown(size_px, rng, (1.5, 3.0), 2.6)
    grain = fields.grains(size_px, rng, 0.9)
    # The wind shifts crests along its way, the more the higher they are, which steepens one side.
    steep = np.asarray(fields.blur(ridge, size_px / 200) * (0.011 * size_px), np.float32)
    ridge = _shift(ridge, steep)
    terrace = 0.5 * smoothstep(-0.2, 0.5, ridge) + 0.5 * smoothstep(0.9, 1.5, ridge)
    height = 0.0035 * drift + 0.0030 * ridge + 0.0065 * terrace
    height += (0.0008 + 0.0007 * terrace) * flutes + 0.00005 * grain
    tone = 1 + 0.008 * grain + 0.006 * flutes + 0.008 * drift
    color = tint(tone, (0.80, 0.818, 0.838))
    glazed = terrace * smoothstep(-0.5, 1.5, flutes)
    color = blend(color, (0.72, 0.757, 0.795), 0.4 * glazed)
    rough = 0.84 - 0.16 * glazed + 0.02 * grain
    return finish_maps(color, height, rough, albedo=0.79, shade=0.15)


def _shift(field: Field, shift_px: Field) -> Field:
    """Return a tileable field, moved along its rows by (N, N) pixels."""
    size_px = len(field)
    rows, columns = np.meshgrid(np.arange(size_px), np.arange(size_px), indexing="ij")
    from_columns = columns - shift_px
    moved = scipy.ndimage.map_coordinates(field, (rows, from_columns), order=1, mode="grid-wrap")
    return np.asarray(moved, np.float32)


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
    "snow": Recipe(snow, tile_m=4.0, albedo=(0.72, 0.88), subsurface=0.5, exposure=-0.8),
    "sastrugi": Recipe(sastrugi, tile_m=7.0, albedo=(0.70, 0.86), subsurface=0.45, exposure=-0.3),
    "ice": Recipe(ice, tile_m=3.6, albedo=(0.15, 0.35), subsurface=0.6, exposure=-0.6),
}
