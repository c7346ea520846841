"""Numbers and choices of materials that Cycles' shader nodes and `draft` share."""

from __future__ import annotations

from functools import cache
from math import floor, log2

import numpy as np

from oaisys_core.procedural.textures.levels import MIN_PX
from oaisys_core.scene import PbrMaps, TerrainMaterial
from oaisys_core.scene.tiling import PlainTiling, StochasticTiling, VoronoiTiling, voronoi_tiling
from oaisys_core.types import PinholeIntrinsics

STEPS = 4
"""Steps per octave that angles of pixels are rounded to, so that similar cameras change nothing."""

DRAFT_TEXEL_PX = 2.0
"""Largest texel in pixels where a pixel is looked up once, as in `draft`: at Nyquist's limit."""

TEXEL_PX = 1.0
"""Largest texel in pixels where Cycles renders. Interpolation smears larger ones; with half of it,
the octaves up to Nyquist's limit have the same energy within a percent."""

LOOKUPS = {PlainTiling: 1, VoronoiTiling: 2, StochasticTiling: 3}
"""Texture lookups of each kind of tiling."""

MAX_LOOKUPS = 100
"""A material with more lookups over all layers, sides and levels uses every other level only."""

SIDE_BLEND = 2.5
"""Sharpness of the transition between two sides."""

VARIATION_TILES, VARIATION_TURN_RAD = 7.3, 0.65
"""Size, in tiles of the first layer, and rotation of the pattern that varies the ground's colour,
chosen so that pattern and texture do not repeat together."""

BED_SCALE = (8.0, 1 / 5)
"""Size of the beds of a cliff, along it and upright, in units of the ground's macro variation: from
0.8 m on, and forty times as long as thick."""

BED_BRIGHTNESS_POWER, BRIGHTNESS_CHANNEL = 4, 1
"""Beds are the macro variation times this power of its green channel, which has no tint: they have
five times its contrast in brightness, but no more in hue, or dark beds were blue."""

ALONG_BEDS = (0.8, 0.6, 0.0)
"""Direction along which beds vary, in ``map``."""

MAX_TURNED_LAYERS = 2
"""A turned texture takes two lookups for each layer, whether it is seen or not."""

BELOW_SURFACE = (0.97, 1.0, 1.03)
"""Colour of light that was scattered below the surface of snow or ice, relative to its albedo: ice
absorbs red most."""

BOX_BLEND = 0.25
"""Blend of Blender's box projection between adjacent sides of a rock."""

ROCK_BUMP_M = 0.02
"""Height range of a rock texture's bump map."""

ROCK_BRIGHTNESS = (0.85, 0.3)
"""Least brightness factor of a rock, and the range of its random part."""

PLANT_TINTS = ((0.74, 0.8, 0.82), (1.26, 1.2, 1.08))
"""Factors on the linear colour of the darkest, coldest plant and of the brightest, most yellow one.
Individuals differ in chlorophyll, which absorbs red more than green."""

THROUGH_LEAF = (1.15, 1.1, 0.6)
"""Colour of light that went through a leaf, relative to that of light that its surface reflects:
chlorophyll and carotenes absorb blue on the longer way."""

OBJECT_ROUGHNESS = 0.5
"""Roughness of objects without a texture set."""

IOR = 1.33
"""Refractive index of water; ice has 1.31."""

SHINY, DULL = 0.25, 0.6
"""Roughness up to which a film of water or ice is complete, and from which there is none."""

SHINY_SHARE = 0.01
"""Ground is rendered with gloss if a larger share of its texture is smoother than `DULL`."""

MAX_DUST, DUST_ON_TOP = 0.85, 0.25
"""Share of dust at the ground, and on what faces upward."""

CONTACT, CONTACT_SHARE = 0.6, 0.25
"""Brightness at the very contact with the ground, and where it ends as a share of the dust."""

FINES_FROM, MAX_FINES = 0.6, 0.7
"""Value of a contact map from which fines hide the ground as far as they do, and how far."""

DARK_FROM, DARKEST, FINES_BRIGHTNESS = 0.55, 0.35, 1.08
"""Value from which fines get darker, and their brightness at the thing and away from it. There,
they are damp and in the shade of pores, and light from the sky comes from one side only."""

FINES_ROUGHNESS = 0.9

TRACK_DARKENING = 0.4
"""Share of the light that soil under wheels reflects less: it is pressed, and rough with cleats."""

WET_DARKENING = 0.45
"""Share of the light that wet ground reflects less: water between the grains scatters forwards."""


@cache
def cliff_tiling() -> VoronoiTiling:
    """Return how textures are laid onto cliffs, which show many tiles at once.

    It is used if layers ask for no tiling and are at most `MAX_TURNED_LAYERS`.
    """
    return voronoi_tiling(1.0, 0.3, np.random.default_rng(0))


def pixel_angle_rad(intrinsics: PinholeIntrinsics, texel_px: float = DRAFT_TEXEL_PX) -> float:
    """Return the angle of the largest texel, by which materials choose levels of detail.

    Args:
        intrinsics: The camera's.
        texel_px: Largest texel in pixels. A texel is half as large or larger, but for `STEPS`.
    """
    angle_rad = 1 / max(intrinsics.fx_px, intrinsics.fy_px)
    octaves = floor(STEPS * log2(angle_rad) + 1e-6) / STEPS
    return texel_px * float(2.0**octaves)


def varies(material: TerrainMaterial) -> bool:
    """Return whether the ground's colour varies beyond its textures."""
    variation = material.variation
    has_range = bool(variation.brightness or variation.tint)
    return has_range and bool(np.ptp(material.layers[0].maps.height))


def footprints_m(material: TerrainMaterial) -> list[float]:
    """Return the footprints of a pixel at which the next level of the textures begins."""
    sets = [layer.maps for layer in material.layers]
    finest_m = min(maps.tile_m / len(maps.color_srgb) for maps in sets)
    coarsest_m = max(maps.tile_m / MIN_PX for maps in sets)
    octaves = max(0, round(log2(coarsest_m / finest_m)))
    lookups = sum(LOOKUPS[type(layer.tiling)] for layer in material.layers)
    lookups *= 3 if material.projects_sides else 1
    stride = 1 if lookups * octaves <= MAX_LOOKUPS else 2
    return [finest_m * 2**step for step in range(0, octaves + 1, stride)]


def is_glossy(maps: PbrMaps) -> bool:
    """Return whether a texture set has enough glossy parts to render them."""
    shiny = np.count_nonzero(maps.roughness < DULL * 255)
    return bool(shiny > SHINY_SHARE * maps.roughness.size)
