"""A forest's floor: fallen leaves in layers, twigs, crumbs of humus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.blades import Blades, cast_blades, grass_outline
from oaisys_core.procedural.textures.baking.ground import (
    fine_noises,
    grit,
    sky_share,
    swell,
    wide_blur,
)
from oaisys_core.procedural.textures.baking.leaves import STALK, cast_leaves
from oaisys_core.procedural.textures.baking.sizes import PowerLaw, RosinRammler
from oaisys_core.procedural.textures.baking.stamps import cast_rocks
from oaisys_core.procedural.textures.recipes.finish import (
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

TILE_M = 1.6

LEAVES: tuple[Color, ...] = (
    (0.25, 0.13, 0.055),
    (0.18, 0.095, 0.05),
    (0.31, 0.185, 0.08),
    (0.21, 0.15, 0.095),
    (0.13, 0.08, 0.05),
    (0.34, 0.235, 0.12),
    (0.27, 0.20, 0.13),
    (0.22, 0.165, 0.11),
    (0.36, 0.29, 0.19),
)
"""Linear reflectance. Dry litter reflects more towards red without the edge of green leaves (G.
Asner, "Biophysical and biochemical sources of variability in canopy reflectance", Remote Sens.
Environ. 64, 1998)."""

HUMUS: Color = (0.055, 0.038, 0.026)
ROTTEN: Color = (0.075, 0.052, 0.036)
TWIG: Color = (0.13, 0.105, 0.085)
ALBEDO = 0.13

FALLEN = Laying(buried=(-0.25, 0.1), rest=0.25, follows=0.8, makes_room=False)
"""Leaves that lie on others, and lean as what is below does."""

TWIGS = 160


def leaf_litter(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A forest floor: leaves of 2 to 9 cm in layers, their fragments, crumbs and humus below."""
    lumps = swell(size_px, 3, rng, 2.0)
    leaves, limits = cast_leaves(), (0.002 / TILE_M, 0.012 / TILE_M)
    crumbs = grit(size_px, cast_rocks("slab"), PowerLaw(1.8), 0.9, limits, rng)
    bed = Bed(lumps * np.float32(0.008 / TILE_M) + 0.6 * crumbs.height)
    pour(bed, TILE_M, leaves, PowerLaw(1.5), 0.6, (0.006, 0.025), FALLEN, rng)
    fragments = bed.count
    for cover in (0.5, 0.4):
        pour(bed, TILE_M, leaves, RosinRammler(0.036, 2.5), cover, (0.014, 0.055), FALLEN, rng)
        pour(bed, TILE_M, leaves, PowerLaw(1.5), 0.15, (0.006, 0.02), FALLEN, rng)
    grain, uneven = fine_noises(size_px, rng)
    tone = _tones(bed.count, fragments, rng)[bed.ids]
    is_leaf = bed.ids >= 0
    x, y = bed.local_places()
    color = tone * (1 + 0.05 * grain + 0.10 * uneven)[..., None]
    color *= _veins(x, y, is_leaf)[..., None]
    # Where it is damp, leaves have rotted further: darker, and less colourful.
    damp = smoothstep(-1.0, 2.0, swell(size_px, 3, rng, 1.7) - 0.5 * lumps)
    color = blend(color, ROTTEN, 0.2 + 0.5 * damp)
    earth = tint(1 + 0.25 * crumbs.tone + 0.12 * grain, HUMUS)
    color = np.where(is_leaf[..., None], color, earth)
    height = bed.height + np.float32(0.0002 / TILE_M) * uneven
    height = _with_twigs(height, color, rng)
    color *= sky_share(height, (0.004, 0.012))[..., None]
    scale_to_albedo(color, ALBEDO)
    rough = np.where(is_leaf, 0.72, 0.92) + 0.04 * uneven
    return TextureMaps(linear_to_srgb(color), height, np.clip(rough, 0, 1).astype(np.float32))


def _tones(count: int, fragments: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return (count + 1, 3) linear colours, of old fragments the first; the last is of no leaf."""
    tone = np.array(LEAVES)[rng.integers(len(LEAVES), size=count + 1)]
    tone *= np.exp(rng.normal(0, 0.2, (count + 1, 1)).clip(-0.5, 0.5))
    tone[:fragments] *= 0.6
    return np.asarray(tone, np.float32)


def _veins(x: Field, y: Field, is_leaf: NDArray[np.bool_]) -> Field:
    """Return the (N, N) brightness of leaves by places along and across them, see `Bed`.

    Ribs are paler than what is between them, and the blade is darkest where it dried first: at its
    tip and in blotches.
    """
    along, away = (x + 1) / 2, np.abs(y)
    rib = np.exp(-np.square(away / 0.018))
    lateral = np.cos(2 * np.pi * (8 * along - 5.0 * away))
    veins = smoothstep(0.82, 1.0, lateral) * (along > STALK) * 0.22
    tip = 0.25 * smoothstep(0.75, 1.0, along)
    return np.where(is_leaf, 1 + 0.35 * rib + veins - tip, 1).astype(np.float32)


def _with_twigs(height: Field, color: NDArray[np.float32], rng: np.random.Generator) -> Field:
    """Return heights with twigs on them, whose colour is put into ``color``."""
    size_px = len(height)
    lying = np.full(TWIGS, np.pi / 2)
    twigs = Blades(
        foot=np.column_stack((rng.uniform(0, 1, (TWIGS, 2)), np.zeros(TWIGS))),
        heading=rng.uniform(-np.pi, np.pi, TWIGS),
        length=rng.uniform(0.02, 0.15, TWIGS),
        width=rng.uniform(0.001, 0.003, TWIGS),
        lean=lying,
        droop=np.zeros(TWIGS),
        sway=rng.uniform(-0.5, 0.5, TWIGS),
        outline=grass_outline,
    )
    view = cast_blades([twigs], size_px)
    is_twig = view.ids >= 0
    bright = np.exp(rng.normal(0, 0.25, TWIGS)).astype(np.float32)[view.ids]
    round_ = np.sqrt(np.maximum(1 - np.square(view.across), 0))
    color[is_twig] = (bright * (0.8 + 0.3 * round_))[is_twig, None] * np.array(TWIG, np.float32)
    on = wide_blur(height, size_px / 250) + np.float32(0.003 / TILE_M) * (0.6 + 0.8 * round_)
    return np.where(is_twig, np.maximum(height, on), height).astype(np.float32)


RECIPES: dict[str, Recipe] = {
    "leaf_litter": Recipe(leaf_litter, TILE_M, albedo=(0.08, 0.2), exposure=-0.7, stands_out=True),
}
