"""Recipes of ground that was wet: mud, salt crust."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.textures import cells, fields
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.sizes import RosinRammler
from oaisys_core.procedural.textures.baking.stamps import cast_rocks
from oaisys_core.procedural.textures.recipes.finish import (
    Recipe,
    TextureMaps,
    blend,
    finish_maps,
    smoothstep,
    tint,
)
from oaisys_core.procedural.textures.recipes.stones import pour


def mud(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Churned, wet mud: clods and smears, shining where water stands in the hollows."""
    churned = fields.tile_noise(size_px, 5, rng, 2.0)
    lumps = fields.crests(size_px, 8, rng, octaves=3)
    smear = fields.tile_noise(size_px, 22, rng, 2.1)
    grain = fields.grains(size_px, rng, 1.0)
    height = 0.0050 * churned + 0.006 * lumps + 0.0008 * smear + 0.00006 * grain
    bed = Bed(height)
    firm = np.clip(0.4 + 0.4 * fields.tile_noise(size_px, 3, rng), 0.05, 1)
    law, clods = RosinRammler(0.03, 0.9), Laying(buried=(0.35, 0.7))
    pour(bed, 2.4, cast_rocks("boulder"), law, 0.5, (0.006, 0.1), clods, rng, firm)
    height = fields.blur(bed.height, size_px / 1000)
    level = np.float32(np.quantile(height, 0.16))
    above = height - level
    # Water fills the lowest parts; a capillary fringe around it is wet and dark.
    water = smoothstep(0.0004, -0.0008, above)
    wet = smoothstep(0.026, 0.0, above + 0.0020 * fields.tile_noise(size_px, 9, rng, 1.5))
    tone = 1 + 0.06 * smear + 0.05 * grain + 0.05 * fields.tile_noise(size_px, 3, rng)
    tone += 0.10 * np.clip(bed.above, 0, 1)
    color = tint(tone, (0.118, 0.085, 0.056))
    color = blend(color, (0.068, 0.048, 0.031), 0.85 * wet)
    color = blend(color, (0.038, 0.031, 0.023), 0.85 * water)
    ripple = 0.00003 * fields.tile_noise(size_px, 20, rng, 2.2)
    height = np.where(above < 0, level + 0.04 * above + ripple, height)
    rough = 0.78 - 0.30 * wet + 0.03 * grain
    rough += (0.06 - rough) * water
    return finish_maps(color, height, rough, albedo=0.085, shade=0.6)


def salt_crust(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A salt flat: pale plates, pushed up into broken rims where they meet."""
    plates = cells.voronoi(size_px, 5, rng, warp=0.09, jitter=0.38, smooth=2.8)
    distance = cells.border_distance(plates) / np.float32(size_px)
    uneven = fields.tile_noise(size_px, 12, rng, 1.5)
    coarse = fields.tile_noise(size_px, 45, rng, 1.3)
    grain = fields.grains(size_px, rng, 0.8)
    rim = np.exp(-np.square(distance / (0.006 + 0.0025 * np.clip(uneven, -1, 2))))
    crown = rim * np.clip(0.8 + 0.3 * uneven, 0.2, 1.6)
    split = smoothstep(0.0016, 0.0, distance) * smoothstep(-0.6, 0.6, uneven)
    blisters = np.clip(fields.tile_noise(size_px, 26, rng, 1.8) - 0.7, 0, 2)
    height = 0.006 * crown * (1 + 0.25 * coarse) - 0.004 * split + 0.0009 * blisters
    height += 0.0007 * fields.tile_noise(size_px, 6, rng, 2.0)
    height += 0.00022 * coarse + 0.00008 * grain
    dusty = smoothstep(-0.8, 1.6, fields.tile_noise(size_px, 4, rng, 1.7)) * (1 - 0.8 * rim)
    tone = 1 + 0.02 * coarse + 0.02 * grain + 0.03 * blisters
    color = tint(tone, (0.66, 0.63, 0.575))
    color = blend(color, (0.47, 0.40, 0.31), 0.45 * dusty)
    color = blend(color, (0.78, 0.77, 0.74), 0.55 * np.clip(crown, 0, 1))
    color = blend(color, (0.36, 0.29, 0.21), 0.7 * split)
    return finish_maps(color, height, 0.75 + 0.03 * grain, albedo=0.55, shade=0.5)


RECIPES: dict[str, Recipe] = {
    "mud": Recipe(mud, tile_m=2.4, albedo=(0.05, 0.12), exposure=-0.8),
    "salt_crust": Recipe(salt_crust, tile_m=4.0, albedo=(0.45, 0.65), exposure=-0.8),
}
