"""Recipes of bare rock: broken and weathered faces, ropy lava."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import cells, fields
from oaisys_core.procedural.textures.baking.ground import (
    all_at_half,
    fine_noises,
    swell,
    wide_blur,
)
from oaisys_core.procedural.textures.recipes.finish import (
    BAKED_PX,
    Color,
    Make,
    Recipe,
    TextureMaps,
    blend,
    finish_maps,
    smoothstep,
    tint,
)
from oaisys_core.types import FloatArray

ROCK_M, BASALT_M, BEDROCK_M = 2.0, 2.0, 4.0

BLOCKS_M = (0.70, 0.26, 0.10, 0.038)
"""Sizes of the blocks into which rock breaks, and of the chips that come off their faces."""

JOINTS_RAD = (0.0, 1.9, 3.9)
"""Azimuths of the sets of joints, from the first: faces lean along them."""

LEANS = (0.12, 0.20, 0.25, 0.24)
"""Slopes of the faces of blocks, by size."""

STEPS = (0.018, 0.022, 0.020, 0.015)
"""Deviations of the heights of blocks, relative to their sizes."""

BENDS = (0.018, 0.025, 0.045, 0.065)
"""How far borders of blocks are bent, relative to their sizes: large joints are straight."""

TONES = (1.0, 0.7, 0.45, 0.3)
"""Deviations of their tones, relative to that of the largest: from afar, nothing else is seen."""

CRACKED, CRACK_M = 1, 0.003
"""Of which size the blocks are that have cracks between them, and half of their largest width."""


class Broken(NamedTuple):
    """Faces of broken rock.

    Attributes:
        height: (N, N) in tile edges.
        tone: (N, N) random value of each face, with standard deviation of about 1.
        crack: (N, N) 1 in the middle of a crack, 0 outside.
    """

    height: Field
    tone: Field
    crack: Field


class BlockShape(NamedTuple):
    """Blocks of one size.

    Attributes:
        along: Blocks along the edge of a tile.
        lean: Slope of their faces.
        step: Deviation of their heights, in tile edges.
        bend: How far their borders are bent, relative to their size.
    """

    along: int
    lean: float
    step: float
    bend: float


class Look(NamedTuple):
    """The colours of a kind of rock, linear reflectance.

    Attributes:
        fresh: Of faces that broke lately.
        stained: Of those that iron has stained.
        aged: Of those that have been in the weather for long.
        lichen: Of crusts that grow on it.
        albedo: Mean luminance.
        shattered: How much of it is broken to chips, 0 to 1.
    """

    fresh: Color
    stained: Color
    aged: Color
    lichen: Color
    albedo: float
    shattered: float


SANDSTONE = Look(
    (0.27, 0.20, 0.138), (0.26, 0.155, 0.085), (0.19, 0.165, 0.14), (0.26, 0.25, 0.20), 0.17, 0.35
)
TRAP = Look(
    (0.112, 0.109, 0.105), (0.135, 0.098, 0.07), (0.085, 0.083, 0.08), (0.13, 0.13, 0.115), 0.1, 0.4
)
LIMESTONE = Look(
    (0.235, 0.205, 0.172), (0.235, 0.168, 0.105), (0.19, 0.185, 0.178), (0.3, 0.3, 0.255), 0.21, 0.6
)

GRIT: Color = (0.235, 0.19, 0.14)
"""Of what lies in the hollows of bedrock."""


def rock(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Weathered, brown sandstone."""
    return _weathered(size_px, ROCK_M, SANDSTONE, rng)


def basalt(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Dark grey rock with the bubbles of its lava, to lie on regolith."""
    plain = _weathered(size_px, BASALT_M, TRAP, rng)
    gassy = np.clip(0.3 + 0.5 * swell(size_px, 4, rng, 1.8), 0.02, 1)
    holes = fields.spread(size_px, 6500, (0.0014, 0.010), 2.4, rng, gassy)
    depth = fields.domes(size_px, *holes) / size_px
    color = plain.color * (1 - 0.35 * smoothstep(0.0, 0.004, depth))[..., None]
    return TextureMaps(color, plain.height - 0.8 * depth, plain.roughness)


def bedrock(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """A pavement of broken limestone with grit in its low parts."""
    return _weathered(size_px, BEDROCK_M, LIMESTONE, rng, grit_share=0.1)


def lava(size_px: int, rng: np.random.Generator) -> TextureMaps:
    """Ropy lava: lobes whose skin was pushed into folds, creases between them, bubbles."""
    lobes = cells.voronoi(size_px, 4, rng, warp=0.10, jitter=0.42, smooth=2.6)
    edge = cells.border_distance(lobes) / np.float32(size_px)
    x, y = cells.from_centre(lobes)
    flow = rng.normal(0.6, 0.5, int(lobes.max()) + 1)[lobes].astype(np.float32)
    # Folds are arcs around the origin of the lobe, a little upstream.
    away = np.hypot(x + 0.16 * np.cos(flow), y + 0.16 * np.sin(flow))
    away += 0.010 * fields.tile_noise(size_px, 4, rng, 2.2)
    away += 0.0022 * fields.tile_noise(size_px, 14, rng, 1.9)
    pace = rng.uniform(20, 38, int(lobes.max()) + 1)[lobes].astype(np.float32)
    rope = np.sqrt(np.abs(np.sin(np.pi * pace * away)) + 0.02)
    calm = smoothstep(-0.9, 0.9, fields.tile_noise(size_px, 4, rng, 2.0))
    strength = (0.25 + 0.75 * calm) * smoothstep(0.0, 0.02, edge)
    wrinkle = fields.tile_noise(size_px, 30, rng, 1.6)
    grain = fields.grains(size_px, rng, 0.8)
    height = 0.009 * strength * rope + 0.012 * np.sqrt(np.clip(edge / 0.1, 0, 1))
    height += 0.0030 * fields.tile_noise(size_px, 4, rng, 2.1) + 0.00035 * wrinkle
    holes = fields.spread(size_px, 5000, (0.0008, 0.0045), 2.2, rng, np.clip(1.1 - calm, 0.1, 1))
    depth = fields.domes(size_px, *holes) / size_px
    height += 0.00010 * grain - 0.7 * depth
    tone = 1 + 0.12 * (rope - 0.6) * strength + 0.06 * wrinkle + 0.06 * grain
    tone += 0.08 * cells.per_cell(lobes, rng) + 0.06 * fields.tile_noise(size_px, 3, rng)
    color = tint(tone, (0.072, 0.069, 0.068))
    rusty = smoothstep(0.6, 2.0, fields.tile_noise(size_px, 6, rng, 1.5))
    color = blend(color, (0.11, 0.075, 0.052), 0.5 * rusty)
    low = smoothstep(0.0, -0.006, height - fields.blur(height.astype(np.float32), size_px / 60))
    color = blend(color, (0.115, 0.10, 0.085), 0.45 * low)
    return finish_maps(color, height, 0.68 + 0.1 * low + 0.05 * wrinkle, albedo=0.068, shade=0.7)


def _weathered(
    size_px: int, tile_m: float, look: Look, rng: np.random.Generator, grit_share: float = 0.0
) -> TextureMaps:
    """Return rock that is broken into blocks, worn, stained and grown over."""
    broken = _broken(size_px, tile_m, look.shattered, rng)
    grain, uneven = fine_noises(size_px, rng)
    rough = fields.tile_noise(size_px, round(3 * tile_m), rng, 1.75)
    height_m = tile_m * broken.height + 0.0040 * rough + 0.0010 * uneven + 0.00025 * grain
    edge = np.clip((height_m - fields.blur(height_m, 0.013 / tile_m * size_px)) / 0.005, -1, 1)
    height_m -= 0.02 * broken.crack
    tone = 1 + 0.085 * broken.tone + 0.05 * rough + 0.03 * uneven + 0.04 * grain
    tone += 0.09 * edge - 0.2 * broken.crack
    color = _age(look, tone, broken, grain, tile_m, rng)
    if grit_share:
        fill_m = wide_blur(height_m, 0.033 / tile_m * size_px)
        hollow_m = height_m - wide_blur(height_m, 0.1 / tile_m * size_px) + 0.0025 * rough
        level_m = np.float32(np.quantile(hollow_m[::4, ::4], grit_share))
        share = smoothstep(0.005, -0.005, hollow_m - level_m)
        fill_m += 0.0005 * grain + 0.001 * uneven
        height_m += (np.maximum(fill_m, height_m) - height_m) * share
        color = blend(color, tint(1 + 0.09 * grain + 0.06 * uneven, GRIT), 0.85 * share)
    height = np.asarray(height_m / tile_m, np.float32)
    return finish_maps(color, height, 0.86 + 0.03 * grain, albedo=look.albedo, shade=0.5)


def _broken(size_px: int, tile_m: float, shattered: float, rng: np.random.Generator) -> Broken:
    """Return blocks within blocks, whose faces lean along a few directions."""
    azimuths = rng.uniform(0, 2 * np.pi) + np.array(JOINTS_RAD)
    leans = np.stack((np.cos(azimuths), np.sin(azimuths)), axis=1)
    coarse = _patches_along(tile_m)
    share = smoothstep(-0.9, 0.9, swell(size_px, coarse, rng, 1.9) + 2 * shattered - 1)
    chipped = share * smoothstep(-0.2, 1.2, swell(size_px, 2 * coarse, rng, 1.7))
    height, tone, crack = (np.zeros((size_px, size_px), np.float32) for _ in range(3))
    present = (
        np.ones_like(height),
        0.35 + 0.65 * share,
        0.15 + 0.85 * chipped,
        0.15 + 0.6 * chipped,
    )
    for number, part in enumerate(present):
        count = max(2, round(tile_m / BLOCKS_M[number]))
        shape = BlockShape(count, LEANS[number], STEPS[number] / count, BENDS[number])
        blocks = partial(_blocks, shape, leans, rng)
        faces, each, border = all_at_half(size_px, blocks)
        height += part * faces
        tone += TONES[number] * part * each
        if number == CRACKED:
            is_open = smoothstep(0.3, 1.3, swell(size_px, coarse + 2, rng, 1.8))
            crack = is_open * np.clip(1 - border * (tile_m / CRACK_M), 0, 1)
    return Broken(height, tone, crack)


def _blocks(
    shape: BlockShape, leans: FloatArray, rng: np.random.Generator, size_px: int
) -> tuple[Field, Field, Field]:
    """Return heights, a random value of each block, and distances to borders, in tile edges.

    Args:
        shape: Of the blocks.
        leans: (J, 2) unit vectors along which faces lean.
        rng: Draws them.
        size_px: Edge length of the tile.
    """
    ids = cells.voronoi(size_px, shape.along, rng, warp=shape.bend, jitter=0.49, smooth=1.7)
    faces = cells.facet_heights(ids, rng, shape.lean * leans, 0.5 * shape.lean)
    each = cells.per_cell(ids, rng)
    return faces + np.float32(shape.step) * each, each, cells.border_distance(ids) / size_px


def _age(
    look: Look, tone: Field, broken: Broken, grain: Field, tile_m: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return the (N, N, 3) colour of faces that are fresh, stained, old and grown over."""
    size_px, coarse = len(tone), _patches_along(tile_m)
    color = tint(tone, look.fresh)
    for over, least, most in ((look.stained, -0.2, 1.6), (look.aged, 0.1, 1.5)):
        patches = swell(size_px, coarse + 1, rng, 1.6) + 0.5 * broken.tone
        color = blend(color, tint(tone, over), 0.6 * smoothstep(least, most, patches))
    wet = smoothstep(0.5, 1.9, fields.tile_noise(size_px, 2 * coarse, rng, 1.5))
    color *= (1 - 0.4 * wet)[..., None]
    crust = fields.tile_noise(size_px, round(6.5 * tile_m), rng, 1.35)
    crust += 0.35 * swell(size_px, coarse, rng, 2.0)
    color = blend(color, tint(1 + 0.1 * grain, look.lichen), 0.6 * smoothstep(1.05, 1.4, crust))
    spots = smoothstep(1.25, 1.6, fields.tile_noise(size_px, round(10 * tile_m), rng, 1.3))
    return blend(color, 0.3 * np.array(look.aged), 0.5 * spots)


def _patches_along(tile_m: float) -> int:
    """Return how many patches of more and of less broken rock there are along a tile."""
    return round(0.75 * tile_m) + 1


def _face(make: Make, tile_m: float, albedo: tuple[float, float]) -> Recipe:
    return Recipe(make, tile_m, albedo, exposure=1.0, stands_out=True, size_px=BAKED_PX)


RECIPES: dict[str, Recipe] = {
    "rock": _face(rock, ROCK_M, (0.1, 0.25)),
    "basalt": _face(basalt, BASALT_M, (0.06, 0.13)),
    "bedrock": _face(bedrock, BEDROCK_M, (0.15, 0.3)),
    "lava": Recipe(lava, tile_m=3.0, albedo=(0.04, 0.1), exposure=0.6, stands_out=True),
}
