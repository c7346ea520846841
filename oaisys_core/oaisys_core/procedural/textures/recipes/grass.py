"""Recipes of grass: a meadow, and grazed turf."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.procedural.textures.baking.blades import cast_blades, leaf_outline
from oaisys_core.procedural.textures.baking.ground import fine_noises, grit, swell
from oaisys_core.procedural.textures.baking.sizes import PowerLaw
from oaisys_core.procedural.textures.baking.stamps import cast_rocks
from oaisys_core.procedural.textures.recipes.finish import (
    BAKED_PX,
    Color,
    Recipe,
    TextureMaps,
    from_finer_texels,
    smoothstep,
    tint,
)
from oaisys_core.procedural.textures.recipes.swards import (
    STRAW,
    Blade,
    Crop,
    Plot,
    grow,
    grow_clover,
    sward_maps,
)

RED_FESCUE: tuple[Color, ...] = (
    (0.070, 0.115, 0.040),
    (0.085, 0.130, 0.045),
    (0.060, 0.100, 0.040),
    (0.105, 0.140, 0.055),
)
MEADOW_GRASS: tuple[Color, ...] = (
    (0.105, 0.175, 0.038),
    (0.125, 0.190, 0.045),
    (0.090, 0.150, 0.036),
    (0.150, 0.200, 0.055),
)
COCKSFOOT: tuple[Color, ...] = ((0.085, 0.140, 0.060), (0.100, 0.155, 0.065))
CLOVER: tuple[Color, ...] = ((0.060, 0.120, 0.035), (0.075, 0.140, 0.040))
HERB: tuple[Color, ...] = ((0.085, 0.145, 0.040), (0.110, 0.165, 0.050))
"""Linear reflectance, highest in the green. Leaves absorb less light near 600 nm, which is red to
the eye, than near 670 nm (J. Woolley, "Reflectance and transmittance of light by leaves", Plant
Physiol. 47, 1971)."""

EARTH: Color = (0.085, 0.063, 0.044)

PATCH_PX = 256
"""Edge length of the maps of where a kind grows, and of the wind."""

LYING = (1.35, 1.6)
"""Angle from the vertical of what lies on the ground."""

MEADOW = (
    Blade(5200, (0.03, 0.11), (0.0012, 0.0028), LYING, (-0.1, 0.1), STRAW, low_m=(0, 0.006),
          segments=2),
    Blade(6000, (0.02, 0.05), (0.0011, 0.0022), (0.4, 1.2), (0.2, 0.9), MEADOW_GRASS, 0.012, 6,
          dry=0.15, segments=3),
    Blade(9500, (0.05, 0.14), (0.0011, 0.0018), (0.15, 0.75), (0.5, 1.3), RED_FESCUE, 0.022, 45,
          dry=0.10, segments=3),
    Blade(5500, (0.04, 0.12), (0.0018, 0.0036), (0.2, 0.8), (0.3, 1.2), MEADOW_GRASS, 0.016, 14,
          dry=0.06),
    Blade(260, (0.08, 0.18), (0.0040, 0.0065), (0.3, 0.8), (0.6, 1.2), COCKSFOOT, 0.02, 22,
          dry=0.04),
    Blade(14, (0.04, 0.09), (0.012, 0.020), (1.0, 1.4), (0.0, 0.4), HERB, 0.006, 8,
          outline=leaf_outline, segments=6),
)  # fmt: skip
"""Straw, a lower storey, tufts of red fescue, meadow-grass and cocksfoot, rosettes of herbs."""

TURF = (
    Blade(6000, (0.01, 0.04), (0.0009, 0.0018), LYING, (-0.1, 0.1), STRAW, low_m=(0, 0.003),
          segments=1),
    Blade(20000, (0.012, 0.030), (0.0012, 0.0022), (0.6, 1.4), (0.1, 0.6), MEADOW_GRASS, 0.010, 6,
          dry=0.10, segments=2),
    Blade(16000, (0.022, 0.050), (0.0010, 0.0015), (0.3, 1.1), (0.4, 1.1), RED_FESCUE, 0.016, 30,
          dry=0.07, segments=2),
    Blade(15000, (0.016, 0.042), (0.0016, 0.0030), (0.4, 1.1), (0.3, 1.0), MEADOW_GRASS, 0.012, 8,
          dry=0.05, segments=3),
    Blade(60, (0.015, 0.035), (0.006, 0.011), (1.2, 1.5), (0.0, 0.3), HERB, 0.004, 8,
         low_m=(0.002, 0.008), outline=leaf_outline, segments=5),
)  # fmt: skip
"""As `MEADOW`, but short; the herbs are daisies."""


class Sward(NamedTuple):
    """A composition of grass.

    Attributes:
        tile_m: Edge length of its tile.
        kinds: The first grows everywhere, the others where it is green.
        clover_per_m2: Leaves of clover where it is at its densest.
        clover_m: Their height.
        extinction_per_m, relief: See `sward_maps`.
        cover: Share of the densest growth that is left in the poorest places.
    """

    tile_m: float
    kinds: tuple[Blade, ...]
    clover_per_m2: float
    clover_m: tuple[float, float]
    extinction_per_m: float
    relief: float
    cover: float


GRASS_SWARD = Sward(1.8, MEADOW, 700, (0.02, 0.06), 28.0, 0.10, 0.35)
TURF_SWARD = Sward(1.6, TURF, 700, (0.012, 0.025), 55.0, 0.20, 0.45)


@from_finer_texels
def grass(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A meadow, not mown for a while: tufts of leaning blades, some dry, over straw and earth."""
    return _bake(GRASS_SWARD, size_px, rng)


@from_finer_texels
def turf(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Short turf, grazed: a dense mat of fine blades with clover, thin in places."""
    return _bake(TURF_SWARD, size_px, rng)


def _bake(sward: Sward, size_px: int, rng: np.random.Generator) -> TextureMaps:
    tile_m = sward.tile_m
    limits = (0.002 / tile_m, 0.010 / tile_m)
    crumbs = grit(size_px, cast_rocks("boulder"), PowerLaw(2.0), 0.8, limits, rng)
    ground = swell(size_px, 6, rng, 2.0) * np.float32(0.004 / tile_m) + crumbs.height
    crops = _sow(sward, ground, rng)
    grain, uneven = fine_noises(size_px, rng)
    earth = tint(1 + 0.2 * crumbs.tone + 0.12 * grain + 0.08 * uneven, EARTH)
    return sward_maps(
        cast_blades([each.blades for each in crops], size_px),
        np.concatenate([each.colors for each in crops]),
        ground,
        earth,
        tile_m,
        extinction_per_m=sward.extinction_per_m,
        relief=sward.relief,
    )


def _sow(sward: Sward, ground: Field, rng: np.random.Generator) -> list[Crop]:
    wind = 1.3 * fields.tile_noise(PATCH_PX, 3, rng, 1.9)
    bright = 0.09 * fields.tile_noise(PATCH_PX, 5, rng, 1.7)
    crops = []
    for number, kind in enumerate(sward.kinds):
        patches = smoothstep(-1.3, 0.6, fields.tile_noise(PATCH_PX, 5, rng, 1.6))
        density = sward.cover + (1 - sward.cover) * patches if number else np.ones_like(patches)
        crops.append(grow(kind, Plot(sward.tile_m, ground, wind, density, bright), rng))
    patches = smoothstep(0.2, 1.4, fields.tile_noise(PATCH_PX, 4, rng, 1.6))
    plot = Plot(sward.tile_m, ground, wind, patches, bright)
    crops.append(grow_clover(sward.clover_per_m2, sward.clover_m, CLOVER, plot, rng))
    return crops


RECIPES: dict[str, Recipe] = {
    "grass": Recipe(grass, GRASS_SWARD.tile_m, (0.09, 0.2), exposure=-0.4, size_px=BAKED_PX),
    "turf": Recipe(turf, TURF_SWARD.tile_m, (0.09, 0.2), exposure=-0.3, size_px=BAKED_PX),
}
