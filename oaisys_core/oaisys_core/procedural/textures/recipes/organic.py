"""Recipes of living and dead plants: grass, moss, fallen leaves."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.procedural.textures.recipes import strokes
from oaisys_core.procedural.textures.recipes.finish import (
    Color,
    Recipe,
    TextureMaps,
    blend,
    finish_maps,
    smoothstep,
    tint,
)
from oaisys_core.procedural.textures.recipes.strokes import Profile, RibbonLayer, Ribbons
from oaisys_core.types import FloatArray

GRASS: tuple[Color, ...] = (
    (0.115, 0.165, 0.045),
    (0.135, 0.185, 0.050),
    (0.090, 0.140, 0.040),
    (0.175, 0.205, 0.065),
    (0.105, 0.150, 0.055),
    (0.230, 0.220, 0.090),
)
STRAW: tuple[Color, ...] = (
    (0.36, 0.28, 0.16),
    (0.28, 0.21, 0.12),
    (0.43, 0.35, 0.21),
    (0.20, 0.15, 0.09),
)
MOSS: tuple[Color, ...] = (
    (0.088, 0.106, 0.028),
    (0.062, 0.082, 0.025),
    (0.118, 0.130, 0.034),
    (0.100, 0.105, 0.030),
)
EARTH: Color = (0.105, 0.078, 0.054)


def _scatter(
    size_px: int,
    rng: np.random.Generator,
    number: int,
    length: tuple[float, float],
    width: tuple[float, float],
    *,
    density: Field | None = None,
    heading: Field | None = None,
    turn: float = np.pi,
    bend: float = 0.25,
    low: tuple[float, float] = (0.0, 0.0),
    rise: tuple[float, float] = (0.0, 0.0),
    outline: Profile = strokes.blade,
    arch: Profile = strokes.level,
    curl: float = 0.0,
) -> Ribbons:
    """Return ribbons at random places; lengths, widths and heights are ranges in tile edges.

    Args:
        size_px: Edge length of the tile.
        rng: Draws all random values.
        number: Number of candidates.
        length, width, low, rise, outline, arch, curl: See `Ribbons`.
        density: (N, N) probability, 0 to 1, that a ribbon is kept; None keeps all.
        heading: (N, N) direction in radians; None for 0.
        turn: Largest deviation from it to either side, in radians.
        bend: Largest sideways deviation of the tips, relative to the length.
    """
    root = rng.uniform(0, size_px, (number, 2))
    stays = rng.uniform(size=number)
    row, column = root.astype(np.intp).T
    way = rng.uniform(-turn, turn, number)
    if heading is not None:
        way += heading[row, column]
    drawn: list[FloatArray] = [
        rng.uniform(*limits, number) * size_px for limits in (length, width, low, rise)
    ]
    sideways = rng.uniform(-bend, bend, number)
    kept = np.ones(number, bool) if density is None else stays < density[row, column]
    long, wide, foot, top = (v[kept] for v in drawn)
    return Ribbons(
        root[kept], way[kept], long, wide, sideways[kept], foot, top, outline, arch, curl
    )


def _tones(
    colors: tuple[Color, ...], count: int, rng: np.random.Generator, spread: float
) -> FloatArray:
    """Return (count, 3) linear colours, each one of ``colors``, brighter or darker."""
    tone = np.array(colors)[rng.integers(len(colors), size=count)]
    return np.asarray(tone * rng.normal(1.0, spread, (count, 1)).clip(0.5, 1.6))


def grass(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A meadow, not mown for a while: tufts of leaning blades, some dry, over straw and earth."""
    lush = fields.tile_noise(size_px, 4, rng, 1.7)
    wind = 1.4 * fields.tile_noise(size_px, 3, rng, 1.9)
    tufts = smoothstep(-1.6, 0.3, fields.tile_noise(size_px, 9, rng, 1.5) + 0.5 * lush)
    ribbon_layer = RibbonLayer(size_px, 0.05 * size_px)
    thatch = _scatter(
        size_px, rng, 9000, (0.02, 0.07), (0.0012, 0.0022), low=(0.0, 0.004), rise=(0, 0.004)
    )
    ribbon_layer.lay(thatch)
    dry = ribbon_layer.count
    lower = _scatter(
        size_px,
        rng,
        26000,
        (0.012, 0.035),
        (0.0014, 0.0026),
        heading=wind,
        turn=2.4,
        bend=0.4,
        low=(0.0, 0.008),
        rise=(0.002, 0.014),
        arch=strokes.arc,
        density=0.4 + 0.6 * tufts,
    )
    ribbon_layer.lay(lower)
    upper = _scatter(
        size_px,
        rng,
        17000,
        (0.02, 0.06),
        (0.0014, 0.0030),
        heading=wind,
        turn=1.3,
        bend=0.45,
        low=(0.004, 0.014),
        rise=(0.006, 0.026),
        arch=strokes.arc,
        density=tufts,
    )
    ribbon_layer.lay(upper)
    tone = np.concatenate(
        (_tones(STRAW, dry, rng, 0.2), _tones(GRASS, ribbon_layer.count - dry, rng, 0.16))
    ).astype(np.float32)
    withered = rng.uniform(size=ribbon_layer.count) < 0.07
    tone[withered] = _tones(STRAW, int(withered.sum()), rng, 0.2)
    ids, along, across = ribbon_layer.ids, ribbon_layer.along, ribbon_layer.across
    color = tone[ids]
    # The foot is pale and brownish, the tip dries first, and a blade is folded along its rib.
    color = blend(color, (0.26, 0.23, 0.12), 0.45 * smoothstep(0.3, 0.0, along))
    color = blend(color, (0.30, 0.26, 0.12), 0.35 * smoothstep(0.82, 1.0, along))
    color *= (1 + 0.22 * across * np.where(ids % 2, 1, -1))[..., None]
    earth = tint(1 + 0.15 * fields.tile_noise(size_px, 40, rng, 1.3), EARTH)
    color = np.where((ids >= 0)[..., None], color, earth)
    color *= (1 + 0.07 * lush)[..., None] * (1 + lush[..., None] * np.array((-0.03, 0.02, -0.02)))
    height = ribbon_layer.height_px / size_px
    color *= (0.50 + 0.50 * smoothstep(-0.005, 0.005, _over(height, 0.012)))[..., None]
    rough = np.where(ids >= 0, 0.72, 0.95).astype(np.float32)
    relief = 0.10 * fields.blur(height, 0.8) + 0.15 * fields.blur(height, size_px / 170)
    return finish_maps(color, relief, rough, albedo=0.15, shade=0.2)


def moss(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Cushions of moss: thousands of star-shaped shoots, older parts brown, over dark earth."""
    cushions = fields.spread(size_px, 700, (0.02, 0.085), 1.6, rng)
    cushion = np.sqrt(fields.domes(size_px, *cushions) / (0.05 * size_px))
    cushion += 0.10 * fields.tile_noise(size_px, 8, rng, 1.9)
    cushion = fields.blur(cushion.astype(np.float32), size_px / 250)
    age = fields.tile_noise(size_px, 4, rng, 1.6)
    cover = smoothstep(-2.1, -1.2, age + 0.8 * cushion) * (0.3 + 0.7 * smoothstep(0, 0.5, cushion))
    ribbon_layer = RibbonLayer(size_px, 0.08 * size_px)
    shoots = _shoots(size_px, rng, 60000, cover)
    row, column = shoots.root.astype(np.intp).T % size_px
    base = (0.028 * np.maximum(cushion, 0) * size_px)[row, column]
    ribbon_layer.lay(shoots._replace(low=shoots.low + base))
    ids, along = ribbon_layer.ids, ribbon_layer.along
    shoot = np.maximum(ids, 0) // SHOOT_LEAVES
    tone = _tones(MOSS, int(shoot.max()) + 1, rng, 0.18).astype(np.float32)
    color = tone[shoot] * (0.55 + 0.75 * along)[..., None]
    brown = smoothstep(0.5, 2.2, age + 0.5 * rng.standard_normal(len(tone))[shoot])
    color = blend(color, (0.15, 0.10, 0.045), 0.75 * brown.astype(np.float32))
    color *= (1 + 0.10 * age)[..., None]
    earth = tint(1 + 0.2 * fields.tile_noise(size_px, 40, rng, 1.3), (0.05, 0.038, 0.026))
    earth = blend(earth, (0.035, 0.042, 0.014), 0.8 * smoothstep(0.1, 0.5, cover))
    color = np.where((ids >= 0)[..., None], color, earth)
    height = np.where(ids >= 0, ribbon_layer.height_px / size_px, 0.028 * cushion).astype(
        np.float32
    )
    color *= (0.5 + 0.5 * smoothstep(-0.004, 0.003, _over(height, 0.006)))[..., None]
    wide = fields.blur(height, size_px / 200)
    relief = wide + 0.25 * (fields.blur(height, 0.7) - wide)
    return finish_maps(color, relief, 0.92 - 0.12 * along, albedo=0.085, shade=0.5)


SHOOT_LEAVES = 7
"""Leaves of one shoot of moss."""


def _shoots(size_px: int, rng: np.random.Generator, number: int, cover: Field) -> Ribbons:
    """Return the leaves of shoots of moss: stars of `SHOOT_LEAVES`, one after the other."""
    centres = _scatter(
        size_px, rng, number, (0.0022, 0.0048), (0.0010, 0.0015), low=(0.002, 0.008), density=cover
    )
    count = len(centres.length)
    star = np.tile(np.arange(SHOOT_LEAVES) * (2 * np.pi / SHOOT_LEAVES), count)
    heading = np.repeat(centres.heading, SHOOT_LEAVES) + star
    heading += rng.uniform(-0.3, 0.3, len(heading))
    length = np.repeat(centres.length, SHOOT_LEAVES) * rng.uniform(0.7, 1.1, len(heading))
    root, width, low, bend = (
        np.repeat(v, SHOOT_LEAVES, axis=0)
        for v in (centres.root, centres.width, centres.low, centres.bend)
    )
    # Leaves rise from the middle of the star and bend over: the tips are lower.
    rise = 0.35 * length
    return Ribbons(root, heading, length, width, bend, low, rise, strokes.blade, strokes.arc)


def _over(height: Field, width: float) -> Field:
    """Return the (N, N) height of pixels above their surroundings, in tile edges."""
    return height - fields.blur(height, width * len(height))


def turf(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Short turf, grazed: a dense mat of fine blades, worn down to the earth in places."""
    lush = fields.tile_noise(size_px, 5, rng, 1.7)
    worn = fields.tile_noise(size_px, 7, rng, 1.6)
    covered = smoothstep(-2.2, -0.9, worn + 0.4 * lush)
    wind = 1.2 * fields.tile_noise(size_px, 6, rng, 1.8)
    ribbon_layer = RibbonLayer(size_px, 0.03 * size_px)
    thatch = _scatter(
        size_px, rng, 15000, (0.010, 0.028), (0.0008, 0.0014), rise=(0, 0.003), density=covered
    )
    ribbon_layer.lay(thatch)
    dry = ribbon_layer.count
    for number, rise in ((42000, (0.002, 0.007)), (34000, (0.005, 0.012))):
        blades = _scatter(
            size_px,
            rng,
            number,
            (0.008, 0.020),
            (0.0009, 0.0017),
            heading=wind,
            turn=2.6,
            bend=0.4,
            rise=rise,
            arch=strokes.arc,
            density=0.25 + 0.75 * covered,
        )
        ribbon_layer.lay(blades)
    tone = np.concatenate(
        (_tones(STRAW, dry, rng, 0.2), _tones(GRASS, ribbon_layer.count - dry, rng, 0.16))
    ).astype(np.float32)
    withered = rng.uniform(size=ribbon_layer.count) < 0.12
    tone[withered] = _tones(STRAW, int(withered.sum()), rng, 0.2)
    ids, along = ribbon_layer.ids, ribbon_layer.along
    color = blend(tone[ids], (0.26, 0.23, 0.12), 0.4 * smoothstep(0.3, 0.0, along))
    earth = tint(1 + 0.15 * fields.tile_noise(size_px, 50, rng, 1.3), EARTH)
    color = np.where((ids >= 0)[..., None], color, earth)
    color *= (1 + 0.08 * lush)[..., None] * (1 + lush[..., None] * np.array((-0.04, 0.02, -0.02)))
    height = ribbon_layer.height_px / size_px
    color *= (0.60 + 0.40 * smoothstep(-0.003, 0.003, _over(height, 0.008)))[..., None]
    rough = np.where(ids >= 0, 0.74, 0.95).astype(np.float32)
    relief = 0.12 * fields.blur(height, 0.8) + 0.2 * fields.blur(height, size_px / 170)
    return finish_maps(color, relief + 0.0015 * covered, rough, albedo=0.15, shade=0.2)


RECIPES: dict[str, Recipe] = {
    "grass": Recipe(grass, tile_m=1.8, albedo=(0.12, 0.25), exposure=-0.4),
    "turf": Recipe(turf, tile_m=1.6, albedo=(0.10, 0.25), exposure=-0.3),
    "moss": Recipe(moss, tile_m=1.4, albedo=(0.05, 0.15), exposure=-0.4),
}
