"""Moss: stars of hair-cap moss in cushions, mats of feather moss between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.procedural.textures.baking.blades import (
    Blades,
    blades_as_one,
    cast_blades,
    taper_outline,
    texels_at,
)
from oaisys_core.procedural.textures.baking.ground import (
    at_half,
    fine_noises,
    sky_share,
    swell,
    wide_blur,
)
from oaisys_core.procedural.textures.recipes.finish import (
    BAKED_PX,
    Color,
    Recipe,
    TextureMaps,
    blend,
    from_finer_texels,
    linear_to_srgb,
    scale_to_albedo,
    smoothstep,
)
from oaisys_core.types import FloatArray

TILE_M = 1.4

HAIR_CAP: tuple[Color, ...] = (
    (0.070, 0.105, 0.026),
    (0.050, 0.082, 0.024),
    (0.095, 0.125, 0.030),
    (0.082, 0.105, 0.030),
)
FEATHER: tuple[Color, ...] = (
    (0.115, 0.135, 0.030),
    (0.140, 0.150, 0.036),
    (0.095, 0.118, 0.028),
    (0.150, 0.145, 0.045),
)
"""Linear reflectance, highest in the green as that of green species in J. Vogelmann and D. Moss,
"Spectral reflectance measurements in the genus Sphagnum", Remote Sens. Environ. 45, 1993."""

BROWN: Color = (0.135, 0.090, 0.040)
HUMUS: Color = (0.040, 0.030, 0.021)
DEAD: Color = (0.045, 0.043, 0.018)
ALBEDO = 0.085

STARS_PER_M2, STAR_LEAVES = 42000, 6
"""Shoots of hair-cap moss on a square metre of it, and leaves of one that are seen from above."""

TURN = 2 * np.pi / STAR_LEAVES

FRONDS_PER_M2, BRANCHES = 12500, 16
"""Fronds of feather moss on a square metre of it, and branches of one."""


class Shoots(NamedTuple):
    """Leaves of shoots, and for each its shoot's (B, 3) linear colour."""

    blades: Blades
    colors: NDArray[np.float32]


@from_finer_texels
def moss(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Moss: cushions of star-shaped shoots, feathery mats between them, over dark humus."""
    ground = _cushions(size_px, rng)
    age = swell(size_px, 4, rng, 1.6)
    kind = swell(size_px, 5, rng, 1.7) + np.float32(30 * TILE_M) * (ground - ground.mean())
    grown = 0.15 + 0.85 * smoothstep(-2.0, -1.1, swell(size_px, 6, rng, 1.6))
    stars = _stars(ground, grown * smoothstep(-0.5, 0.1, kind), age, rng)
    fronds = _fronds(ground, grown * smoothstep(0.3, -0.3, kind), age, rng)
    view = cast_blades([stars.blades, fronds.blades], size_px)
    is_moss = view.height > ground
    color = np.concatenate((stars.colors, fronds.colors))[view.ids]
    color *= ((0.55 + 0.65 * view.along) * (0.75 + 0.25 * view.facing))[..., None]
    grain, uneven = fine_noises(size_px, rng)
    below = blend(np.broadcast_to(np.array(HUMUS, np.float32), color.shape), DEAD, grown)
    below *= (1 + 0.25 * uneven + 0.2 * grain)[..., None]
    color = np.where(is_moss[..., None], color, below)
    height = np.where(is_moss, view.height, ground).astype(np.float32)
    color *= sky_share(height, (0.002 / TILE_M, 0.006 / TILE_M, 0.025 / TILE_M))[..., None]
    scale_to_albedo(color, ALBEDO)
    mean = wide_blur(height, 0.004 / TILE_M * size_px)
    relief = mean + np.float32(0.25) * (fields.blur(height, 0.7) - mean)
    rough = np.where(is_moss, 0.85, 0.95).astype(np.float32)
    return TextureMaps(linear_to_srgb(color), relief.astype(np.float32), rough)


def _cushions(size_px: int, rng: np.random.Generator) -> Field:
    """Return (N, N) heights of cushions of 3 to 12 cm, in tile edges."""

    def domes(part_px: int) -> Field:
        placed = fields.spread(part_px, 550, (0.022, 0.085), 1.6, rng)
        high = np.sqrt(fields.domes(part_px, *placed) / (0.05 * part_px)).astype(np.float32)
        return fields.blur(high, part_px / 200)

    uneven = 0.12 * swell(size_px, 8, rng, 1.9)
    cushions = at_half(size_px, lambda half_px: at_half(half_px, domes))
    return np.asarray(0.024 * (cushions + uneven), np.float32)


def _stars(ground: Field, density: Field, age: Field, rng: np.random.Generator) -> Shoots:
    """Return shoots of hair-cap moss: stars of 5 to 10 mm whose leaves rise and bend outwards."""
    together = blades_as_one(0.0020 / TILE_M, len(ground))
    place, texel = _places(STARS_PER_M2 / together, density, rng)
    shoots = len(place)
    high = ground[texel] + rng.uniform(0, 0.007, shoots) / TILE_M
    heading = rng.uniform(0, 2 * np.pi, (shoots, 1)) + np.arange(STAR_LEAVES) * TURN
    length = rng.uniform(0.0026, 0.0052, (shoots, 1)) * rng.uniform(0.8, 1.15, heading.shape)
    blades = Blades(
        foot=np.repeat(np.column_stack((place, high)), STAR_LEAVES, axis=0),
        heading=(heading + rng.normal(0, 0.2, heading.shape)).reshape(-1),
        length=length.reshape(-1) / TILE_M,
        width=together * rng.uniform(0.0016, 0.0024, heading.size) / TILE_M,
        lean=rng.uniform(0.9, 1.4, heading.size),
        droop=np.zeros(heading.size),
        sway=np.zeros(heading.size),
        outline=taper_outline,
        segments=1,
    )
    return Shoots(blades, np.repeat(_tones(HAIR_CAP, age[texel], rng), STAR_LEAVES, axis=0))


def _fronds(ground: Field, density: Field, age: Field, rng: np.random.Generator) -> Shoots:
    """Return fronds of feather moss: lying stems of 2 to 4 cm with branches on both sides."""
    together = blades_as_one(0.0020 / TILE_M, len(ground))
    place, texel = _places(FRONDS_PER_M2 / together, density, rng)
    fronds, pairs = len(place), BRANCHES // 2
    share = (np.arange(BRANCHES) // 2 + 0.5) / pairs
    length = rng.uniform(0.018, 0.036, (fronds, 1)) / TILE_M
    way = rng.uniform(0, 2 * np.pi, (fronds, 1)) + rng.normal(0, 0.5, (fronds, 1)) * share
    ways = np.stack((np.sin(way), np.cos(way)), axis=-1)
    foot = place[:, None] + ways * (length * share)[..., None]
    lift = rng.uniform(0.001, 0.006, (fronds, 1)) + 0.003 * np.sin(np.pi * share)
    high = ground[texels_at(foot, len(ground))] + lift / TILE_M
    # Branches are longest in the middle of a frond.
    longest = 0.30 * length * np.sin(np.pi * (0.15 + 0.8 * share))
    side = np.where(np.arange(BRANCHES) % 2, 1.0, -1.0) * rng.uniform(0.7, 1.1, way.shape)
    blades = Blades(
        foot=np.concatenate((foot, high[..., None]), axis=-1).reshape(-1, 3),
        heading=(way + side).reshape(-1),
        length=(longest * rng.uniform(0.8, 1.2, way.shape)).reshape(-1),
        width=together * rng.uniform(0.0016, 0.0025, way.size) / TILE_M,
        lean=rng.uniform(1.35, 1.65, way.size),
        droop=np.full(way.size, 0.25),
        sway=rng.normal(0, 0.2, way.size),
        outline=taper_outline,
        segments=1,
    )
    return Shoots(blades, np.repeat(_tones(FEATHER, age[texel], rng), BRANCHES, axis=0))


def _tones(colors: tuple[Color, ...], age: Field, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return (S, 3) colours of shoots, brown where they are old."""
    tone = np.array(colors)[rng.integers(len(colors), size=len(age))]
    tone *= np.exp(rng.normal(0, 0.18, (len(age), 1)) + 0.06 * age[:, None])
    old = 0.75 * smoothstep(0.8, 2.2, age + 0.6 * rng.standard_normal(len(age)).astype(np.float32))
    return blend(tone.astype(np.float32), BROWN, old)


def _places(
    per_m2: float, density: Field, rng: np.random.Generator
) -> tuple[FloatArray, tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return (S, 2) rows and columns of shoots in tile edges, and their texels."""
    place = rng.uniform(0, 1, (round(per_m2 * TILE_M**2), 2))
    place = place[rng.uniform(size=len(place)) < density[texels_at(place, len(density))]]
    return place, texels_at(place, len(density))


RECIPES: dict[str, Recipe] = {
    "moss": Recipe(
        moss, TILE_M, albedo=(0.05, 0.15), exposure=-0.4, stands_out=True, size_px=BAKED_PX
    ),
}
