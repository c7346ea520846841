"""The recipe of wet mud."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.textures import fields
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


RECIPES: dict[str, Recipe] = {
    "mud": Recipe(mud, tile_m=2.4, albedo=(0.05, 0.12), exposure=-0.8, stands_out=True),
}
