"""The recipe of sand in wind ripples."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures.baking import wind
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.ground import enlarge, fine_noises, sky_share, swell
from oaisys_core.procedural.textures.baking.sizes import PowerLaw
from oaisys_core.procedural.textures.baking.stamps import cast_rocks
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

TILE_M = 3.2

WAVES, RIPPLE_M = 31, 0.0036
"""Ripples along the tile, and half of their height. A wavelength of 10 cm is 14 times the height;
wind ripples have 10 to 70 times, most about 15 to 20 (R. Sharp, "Wind ripples", J. Geol. 71, 1963).
"""

SHAPED_PX = 512
"""Edge length at which ripples are shaped: sixteen texels a wave."""

SAND: Color = (0.46, 0.335, 0.215)
HEAVY: Color = (0.20, 0.165, 0.13)
"""Linear reflectance of sand, and of the dark heavy grains that stay in troughs."""

GRAINS, GRAINS_M = Laying(buried=(0.1, 0.5), makes_room=False), (0.0018, 0.0045)
"""How coarse grains lie, and their diameters."""


def rippled_sand(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Sand in wind ripples 10 cm apart: steep lee sides, forks, coarse grains on the crests."""
    ripple = _ripples(size_px, rng)
    uneven = swell(size_px, 3, rng, 2.3)
    strength = np.clip(0.95 + 0.18 * swell(size_px, 4, rng, 2.0), 0.3, 1.3)
    grain, fine = fine_noises(size_px, rng)
    height_m = RIPPLE_M * strength * ripple + 0.003 * uneven + 0.00025 * fine + 0.00012 * grain
    bed = Bed((height_m / TILE_M).astype(np.float32))
    crest = smoothstep(0.1, 0.9, ripple)
    # Wind sorts: coarse grains creep up to the crests.
    sorted_out = np.clip(0.03 + crest * (0.5 + 0.4 * swell(size_px, 5, rng)), 0, 1)
    law = PowerLaw(2.5)
    pour(bed, TILE_M, cast_rocks("rounded"), law, 0.25, GRAINS_M, GRAINS, rng, sorted_out)
    tone = 1 + 0.05 * crest + 0.05 * grain + 0.025 * fine + 0.02 * swell(size_px, 3, rng)
    own = np.append(rng.normal(0.05, 0.22, bed.count).clip(-0.5, 0.5), 0.0).astype(np.float32)
    color = tint(tone + own[bed.ids], SAND)
    dark = np.clip(swell(size_px, 4, rng) - 0.3 - 0.8 * ripple, 0, 1.5) * 0.07
    color = blend(color, HEAVY, dark)
    color *= sky_share(bed.height, (0.006 / TILE_M, 0.03 / TILE_M))[..., None]
    scale_to_albedo(color, 0.32)
    rough = np.clip(0.93 + 0.02 * grain, 0, 1).astype(np.float32)
    return TextureMaps(linear_to_srgb(color), bed.height, rough)


def _ripples(size_px: int, rng: np.random.Generator) -> Field:
    """Return `wind.ripples` of the tile."""
    if size_px <= SHAPED_PX or size_px % SHAPED_PX:
        return wind.ripples(size_px, WAVES, rng)
    return enlarge(wind.ripples(SHAPED_PX, WAVES, rng), size_px // SHAPED_PX)


RECIPES: dict[str, Recipe] = {
    "rippled_sand": Recipe(
        rippled_sand, TILE_M, albedo=(0.28, 0.4), exposure=-0.8, size_px=BAKED_PX
    ),
}
