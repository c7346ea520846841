"""Recipes of snow that the wind has worked on: a packed crust, and sastrugi."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.ground import at_half, fine_noises, sky_share, swell
from oaisys_core.procedural.textures.baking.sizes import PowerLaw
from oaisys_core.procedural.textures.baking.stamps import cast_rocks
from oaisys_core.procedural.textures.baking.wind import Sheet, carve, swerve
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

SNOW_M, SASTRUGI_M = 4.0, 7.0
"""Edge lengths of the tiles."""

FRESH: Color = (0.800, 0.815, 0.830)
GLAZED: Color = (0.725, 0.757, 0.790)
"""Linear reflectance of small grains, and of the coarse ones of a glazed crust, which absorb more,
first of the red (W. Wiscombe and S. Warren, "A model for the spectral albedo of snow. I: Pure
snow", J. Atmos. Sci. 37, 1980)."""

HOLLOW = (0.50, 0.43, 0.36)
"""Exponents by which red, green and blue fall with the share of the sky: light that snow has
scattered into a hollow has lost some of its red."""

CRUST = (Sheet(0.25, 0.004, 0.002), Sheet(1.0, 0.006, 0.004))
RIDGES = (Sheet(0.0, 0.010, 0.009), Sheet(0.7, 0.012, 0.012), Sheet(1.35, 0.014, 0.018))
"""Sheets of the packed crust, and of old, hard snow."""

CRUMBS_M = (0.004, 0.022)
"""Diameters of what broke off a crust."""


def snow(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Wind-packed snow: soft drifts, a crust that wind cut away in sheets, crumbs of it."""

    def crust(px: int) -> Field:
        hardness = fields.windblown(px, rng, (3.5, 7.0), 1.9)
        cut = swerve(carve(hardness, CRUST, 0.035, SNOW_M), 3, 0.007, rng)
        return fields.blur(cut, px / 1400)

    def drifts_m(px: int) -> Field:
        phase, amplitude = fields.narrow_band(px, 27, rng, (0.10, 0.25))
        patch = smoothstep(0.1, 1.3, swell(px, 3, rng, 2.2)) * np.clip(amplitude, 0, 1)
        drift = fields.windblown(px, rng, (2.5, 4.0), 2.5)
        return np.asarray(0.010 * drift + 0.0022 * patch * np.cos(phase), np.float32)

    edges = at_half(size_px, crust)
    bed = Bed(edges + at_half(size_px, drifts_m) / np.float32(SNOW_M))
    broken = np.clip(0.25 + 0.5 * swell(size_px, 4, rng), 0.03, 1)
    clods = Laying(buried=(0.2, 0.6), makes_room=False)
    pour(bed, SNOW_M, cast_rocks("boulder"), PowerLaw(2.4), 0.03, CRUMBS_M, clods, rng, broken)
    return _snow_maps(bed.height, SNOW_M, 0.80, rng)


def sastrugi(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Sastrugi: ridges of old snow that the wind has carved, steep towards it, with long tails."""

    def ridges(px: int) -> Field:
        hardness = fields.windblown(px, rng, (3.0, 9.0), 2.1)
        cut = swerve(carve(hardness, RIDGES, 0.05, SASTRUGI_M), 3, 0.007, rng)
        return fields.blur(cut, px / 1400)

    def drifts_m(px: int) -> Field:
        drift = fields.windblown(px, rng, (1.5, 3.0), 2.6)
        return 0.015 * drift + 0.0016 * fields.windblown(px, rng, (9.0, 50.0), 1.8)

    height = at_half(size_px, ridges) + at_half(size_px, drifts_m) / np.float32(SASTRUGI_M)
    return _snow_maps(height, SASTRUGI_M, 0.79, rng)


def _snow_maps(
    height: Field, tile_m: float, albedo: float, rng: np.random.Generator
) -> TextureMaps:
    """Return the maps of packed snow of a height, in tile edges, with a grainy surface."""
    size_px = len(height)
    grain, uneven = fine_noises(size_px, rng)
    height = height + np.float32(1 / tile_m) * (0.0004 * uneven + 0.0002 * grain)
    # What stands up was packed longest, and is polished.
    glazed = smoothstep(0.004, 0.03, tile_m * (height - np.float32(np.median(height))))
    tone = 1 + 0.008 * grain + 0.006 * uneven + 0.008 * swell(size_px, 3, rng)
    color = blend(tint(tone, FRESH), GLAZED, 0.3 * glazed)
    light = sky_share(height, (0.012 / tile_m, 0.06 / tile_m))
    color *= np.stack([np.power(light, np.float32(each)) for each in HOLLOW], axis=-1)
    scale_to_albedo(color, albedo)
    rough = 0.85 - 0.2 * glazed + 0.03 * grain
    return TextureMaps(linear_to_srgb(color), height, np.clip(rough, 0, 1).astype(np.float32))


RECIPES: dict[str, Recipe] = {
    "snow": Recipe(snow, SNOW_M, (0.72, 0.88), subsurface=0.5, exposure=-0.8, size_px=BAKED_PX),
    "sastrugi": Recipe(
        sastrugi, SASTRUGI_M, (0.70, 0.86), subsurface=0.45, exposure=-0.3, size_px=BAKED_PX
    ),
}
