"""The recipe of a salt flat: plates that grew until their edges broke and rose."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import cells, fields
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.ground import (
    all_at_half,
    at_half,
    fine_noises,
    sky_share,
    swell,
)
from oaisys_core.procedural.textures.baking.sizes import PowerLaw, RosinRammler
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

TILE_M, ALBEDO = 4.0, 0.55
PLATES, PARTS = 4, 11
"""Plates along an edge of the tile, and the parts that thinner seams divide them into. Plates of
salt pans are about a metre wide (J. Lasser et al., "Salt polygons and porous media convection",
Phys. Rev. X 13, 2023)."""

SALT: Color = (0.66, 0.63, 0.575)
DUST: Color = (0.47, 0.40, 0.31)
CLEAN: Color = (0.78, 0.77, 0.74)

RIDGE_M, RIDGE_WIDE_M = 0.028, 0.055
SEAM_M, SEAM_WIDE_M = 0.003, 0.016
"""Heights of ridges and seams, and how far they reach to each side."""

SLABS = Laying(flatness=0.8, buried=(0.3, 0.7), makes_room=False, follows=0.9)
CRYSTALS = Laying(buried=(0.4, 0.8), makes_room=False)
"""How pieces of broken crust lie, and knobs of crystals."""


def salt_crust(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A salt flat: pale plates, their edges broken and pushed up, crystals between thin seams."""
    crust_m, ridge, seam = all_at_half(size_px, lambda px: _plates(px, rng))
    grain, fine = fine_noises(size_px, rng)
    blister = at_half(size_px, lambda px: fields.tile_noise(px, 30, rng, 1.7))
    crust_m = crust_m + 0.0016 * np.clip(blister - 0.3, 0, 2) + 0.0006 * fine + 0.0001 * grain
    bed = Bed((crust_m / TILE_M).astype(np.float32))
    broken = np.clip(1.2 * ridge - 0.35, 0, 1)
    pour(
        bed,
        TILE_M,
        cast_rocks("slab"),
        RosinRammler(0.035, 1.2),
        0.22,
        (0.006, 0.08),
        SLABS,
        rng,
        broken,
    )
    slabs = bed.ids >= 0
    rough_patch = np.clip(0.25 + 0.5 * swell(size_px, 4, rng) + seam, 0.02, 1)
    pour(
        bed,
        TILE_M,
        cast_rocks("rounded"),
        PowerLaw(2.3),
        0.16,
        (0.004, 0.014),
        CRYSTALS,
        rng,
        rough_patch,
    )
    dusty = smoothstep(-0.9, 1.6, swell(size_px, 4, rng, 1.7) + 0.4 * fine) * (1 - 0.8 * ridge)
    color = tint(1 + 0.025 * fine + 0.02 * grain + 0.03 * blister, SALT)
    color = blend(color, DUST, 0.38 * dusty)
    color = blend(color, CLEAN, np.clip(0.5 * ridge + 0.4 * seam + 0.3 * slabs, 0, 0.9))
    color *= sky_share(bed.height, (0.006 / TILE_M, 0.03 / TILE_M))[..., None]
    scale_to_albedo(color, ALBEDO)
    rough = np.clip(0.78 + 0.03 * grain, 0, 1).astype(np.float32)
    return TextureMaps(linear_to_srgb(color), bed.height, rough)


def _plates(size_px: int, rng: np.random.Generator) -> tuple[Field, Field, Field]:
    """Return (N, N) heights of the crust in metres, and the strength of ridges and of seams."""
    plates = cells.voronoi(size_px, PLATES, rng, warp=0.06, jitter=0.38, smooth=2.3)
    parts = cells.voronoi(size_px, PARTS, rng, warp=0.10, jitter=0.42, smooth=2.3)
    to_ridge_m, to_seam_m = (
        np.float32(TILE_M / size_px) * cells.border_distance(each) for each in (plates, parts)
    )
    uneven = fields.tile_noise(size_px, 8, rng, 1.7)
    high = np.clip(0.75 + 0.35 * uneven, 0.1, 1.6)
    # One plate rides over the other, so that a ridge has a gentle and a steep side.
    reach_m = RIDGE_WIDE_M * (0.65 + 0.35 * np.tanh(cells.per_cell(plates, rng)))
    ridge = np.exp(-to_ridge_m / reach_m).astype(np.float32)
    seam = np.exp(-np.square(to_seam_m / SEAM_WIDE_M)) * np.clip(0.7 + 0.4 * uneven, 0.1, 1.3)
    crust_m = RIDGE_M * high * ridge**1.5 + SEAM_M * seam
    crust_m += 0.004 * fields.tile_noise(size_px, 3, rng, 2.2)
    crust_m += 0.0008 * TILE_M * cells.facet_heights(parts, rng)
    return crust_m.astype(np.float32), np.asarray(ridge * high, np.float32), seam.astype(np.float32)


RECIPES: dict[str, Recipe] = {
    "salt_crust": Recipe(
        salt_crust, TILE_M, albedo=(0.45, 0.65), exposure=-0.8, size_px=BAKED_PX, stands_out=True
    ),
}
