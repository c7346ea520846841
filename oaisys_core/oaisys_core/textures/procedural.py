"""Recipes of the built-in texture sets: what the ground is made of, seen from above."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.terrain.noise import Field
from oaisys_core.textures import fields
from oaisys_core.textures.stones import Bed, Pour

Color = tuple[float, float, float]
"""sRGB, 0 to 1."""


class Surface(NamedTuple):
    """A recipe's result.

    Attributes:
        color: (N, N, 3) float32 sRGB, 0 to 1.
        height: (N, N) float32 in tile edges.
        roughness: (N, N) float32, 0 to 1.
    """

    color: NDArray[np.float32]
    height: Field
    roughness: Field


class Recipe(NamedTuple):
    """How a texture set is made, and how large it is in the world.

    Attributes:
        make: (size_px, rng) to its surface.
        tile_m: Edge length of one tile.
    """

    make: Callable[[int, np.random.Generator], Surface]
    tile_m: float


GRAVEL_STONES: tuple[Color, ...] = (
    (0.56, 0.49, 0.41),
    (0.61, 0.54, 0.45),
    (0.50, 0.45, 0.39),
    (0.66, 0.60, 0.51),
    (0.52, 0.43, 0.35),
    (0.57, 0.54, 0.50),
    (0.45, 0.41, 0.37),
)
LUNAR_STONES: tuple[Color, ...] = (
    (0.42, 0.41, 0.40),
    (0.48, 0.47, 0.45),
    (0.37, 0.36, 0.35),
)


def gravel(size_px: int, rng: np.random.Generator) -> Surface:
    """Broken stones of 1 to 20 cm on grit, dust between them."""
    swell = fields.tile_noise(size_px, 3, rng, 2.2)
    color = _dusty(size_px, rng, (0.52, 0.45, 0.36), 0.07)
    bed = Bed(0.0015 * swell + 0.0004 * fields.grains(size_px, rng, 1.0))
    crowded = np.clip(0.75 + 0.3 * fields.tile_noise(size_px, 4, rng), 0.25, 1)
    bed.pour(Pour(21000, (0.0024, 0.007), 2.2, edge=0.06, buried=0.2), rng)
    bed.pour(Pour(2600, (0.007, 0.02), 2.2, edge=0.06, buried=0.25), rng, crowded)
    bed.pour(
        Pour(260, (0.015, 0.042), 2.0, flatness=0.7, edge=0.05, buried=0.3),
        rng,
        crowded,
    )
    bed.pour(Pour(5000, (0.0024, 0.005), 2.2, buried=0.1), rng, crowded)
    return _covered(color, bed, GRAVEL_STONES, rng, roughness=0.86)


def sand(size_px: int, rng: np.random.Generator) -> Surface:
    """Wind-blown sand: faint ripples, hummocks, grit and pebbles in patches."""
    patches = fields.tile_noise(size_px, 2, rng)
    ripples = fields.ripples(size_px, (24, 11), rng, bend=0.02)
    ripples *= np.clip(0.6 + 0.4 * patches, 0, 1)
    hummocks = fields.tile_noise(size_px, 5, rng, 2.1)
    grain = fields.grains(size_px, rng, 0.7)
    crumbs = fields.tile_noise(size_px, 40, rng, 1.3)
    height = 0.0005 * ripples + 0.0016 * hummocks + 0.00018 * grain + 0.0003 * crumbs
    color = _dusty(size_px, rng, (0.64, 0.54, 0.41), 0.035)
    color *= (1 + 0.02 * patches + 0.015 * hummocks + 0.008 * ripples + 0.045 * crumbs)[..., None]
    bed = Bed(height.astype(np.float32))
    gritty = np.clip(0.35 + 0.35 * fields.tile_noise(size_px, 3, rng), 0.06, 1)
    bed.pour(Pour(18000, (0.0011, 0.003), 2.2, buried=0.1), rng, gritty)
    bed.pour(Pour(3200, (0.003, 0.018), 2.1, edge=0.08, buried=0.2), rng, gritty)
    # Without the darkest stones: a few of them in plain sand would show that it repeats.
    return _covered(color, bed, GRAVEL_STONES[:5], rng, roughness=0.93)


def regolith(size_px: int, rng: np.random.Generator) -> Surface:
    """Grey powder with clods and angular fragments, as on the Moon."""
    lumps = fields.tile_noise(size_px, 4, rng, 1.9)
    crumbs = fields.tile_noise(size_px, 40, rng, 1.5)
    height = 0.0022 * lumps + 0.0003 * crumbs + 0.00015 * fields.grains(size_px, rng, 0.8)
    color = _dusty(size_px, rng, (0.43, 0.42, 0.40), 0.05)
    color *= (1 + 0.025 * lumps + 0.03 * crumbs)[..., None]
    bed = Bed(height.astype(np.float32))
    patchy = np.clip(0.4 + 0.4 * fields.tile_noise(size_px, 3, rng), 0.08, 1)
    bed.pour(Pour(16000, (0.0013, 0.004), 2.4, buried=0.2), rng, patchy)
    bed.pour(Pour(1700, (0.004, 0.022), 2.2, edge=0.04, buried=0.3), rng, patchy)
    return _covered(color, bed, LUNAR_STONES, rng, roughness=0.95)


def soil(size_px: int, rng: np.random.Generator) -> Surface:
    """Dry, crusted earth: crumbs, hairline cracks, small stones."""
    clods = fields.tile_noise(size_px, 6, rng, 1.8)
    crumbs = fields.tile_noise(size_px, 45, rng, 1.4)
    crust = np.clip(fields.tile_noise(size_px, 3, rng) * 0.8 + 0.2, 0, 1)
    split = fields.cracks(size_px, 14, rng, width=0.05) * crust
    height = 0.0014 * clods + 0.0004 * crumbs * (1 - 0.7 * crust) - 0.0025 * split
    color = _dusty(size_px, rng, (0.53, 0.43, 0.33), 0.05)
    color *= (1 + 0.015 * clods + 0.04 * crumbs + 0.06 * crust - 0.3 * split)[..., None]
    bed = Bed(height.astype(np.float32))
    stony = np.clip(0.35 + 0.4 * fields.tile_noise(size_px, 4, rng), 0.05, 1)
    bed.pour(Pour(16000, (0.0015, 0.004), 2.2, buried=0.15), rng, stony)
    bed.pour(Pour(2600, (0.004, 0.02), 2.0, edge=0.07, buried=0.2), rng, stony)
    return _covered(color, bed, GRAVEL_STONES, rng, roughness=0.9)


def rock(size_px: int, rng: np.random.Generator) -> Surface:
    """Weathered, brown sandstone."""
    return _weathered(size_px, rng, (0.55, 0.48, 0.40))


def basalt(size_px: int, rng: np.random.Generator) -> Surface:
    """Dark grey rock, to lie on regolith."""
    return _weathered(size_px, rng, (0.40, 0.39, 0.38))


def _weathered(size_px: int, rng: np.random.Generator, tone: Color) -> Surface:
    """Return bare rock: faint layers, broken steps, pits, cracks, stains."""
    layers = fields.strata(size_px, 22, rng)
    mass = fields.tile_noise(size_px, 4, rng, 1.9)
    rough = fields.tile_noise(size_px, 14, rng, 1.7)
    steps = fields.crests(size_px, 5, rng)
    grain = fields.grains(size_px, rng, 0.8)
    # A crack runs only where the rock is weak, so that it ends somewhere.
    weak = np.clip(1.5 * fields.tile_noise(size_px, 2, rng, 2.2) - 0.2, 0, 1)
    split = weak * fields.cracks(size_px, 6, rng, width=0.022)
    pits = np.clip(fields.tile_noise(size_px, 45, rng, 1.7) - 1.6, 0, 1.5)
    height = 0.005 * layers + 0.005 * mass + 0.0011 * rough + 0.010 * steps
    height += 0.0002 * grain - 0.006 * split - 0.002 * pits
    color = _dusty(size_px, rng, tone, 0.05)
    color *= (1 + 0.05 * layers + 0.055 * rough + 0.16 * (steps - 0.6) - 0.3 * split)[..., None]
    stain = fields.tile_noise(size_px, 3, rng)[..., None]
    color *= 1 + 0.025 * stain * np.array((1.0, 0.4, -0.3), np.float32)
    color *= (1 - 0.18 * np.clip(pits, 0, 1))[..., None]
    return _lit(color, height.astype(np.float32), rng, roughness=0.87)


RECIPES: dict[str, Recipe] = {
    "gravel": Recipe(gravel, tile_m=3.2),
    "sand": Recipe(sand, tile_m=3.6),
    "regolith": Recipe(regolith, tile_m=3.4),
    "soil": Recipe(soil, tile_m=3.0),
    "rock": Recipe(rock, tile_m=2.0),
    "basalt": Recipe(basalt, tile_m=2.0),
}


def _dusty(
    size_px: int, rng: np.random.Generator, color: Color, variation: float
) -> NDArray[np.float32]:
    """Return (N, N, 3) of one colour; brightness and, less so, hue vary finely and coarsely."""
    tone = 1 + variation * fields.grains(size_px, rng, 0.6)
    tone += 0.6 * variation * fields.tile_noise(size_px, 6, rng)
    hue = 0.012 * fields.tile_noise(size_px, 2, rng)[..., None]
    warm = 1 + hue * np.array((0.6, 0.0, -1.0), np.float32)
    return np.asarray(tone[..., None] * warm * np.array(color, np.float32), np.float32)


def _covered(
    ground: NDArray[np.float32],
    bed: Bed,
    tones: Sequence[Color],
    rng: np.random.Generator,
    roughness: float,
) -> Surface:
    """Return the surface of a bed; each stone has a tone of its own, and dust around its foot."""
    size_px = len(ground)
    tone = np.array(tones, np.float32)[rng.integers(len(tones), size=bed.count + 1)]
    tone *= rng.normal(1.0, 0.14, (bed.count + 1, 1)).clip(0.65, 1.4).astype(np.float32)
    mottle = 1 + 0.05 * fields.grains(size_px, rng, 0.8)
    mottle += 0.06 * fields.tile_noise(size_px, 30, rng, 1.5)
    stone = tone[bed.ids] * mottle[..., None]
    # Fine dust lies on the foot of a stone, and thinly on all of it.
    bare = np.clip(bed.above * 3.0, 0, 1) * np.float32(0.85)
    bare *= bed.ids >= 0
    color = ground + (stone - ground) * bare[..., None]
    chipped = 0.0002 * fields.tile_noise(size_px, 50, rng, 1.5) * (bed.ids >= 0)
    return _lit(color, bed.height + chipped.astype(np.float32), rng, roughness)


def _lit(
    color: NDArray[np.float32],
    height: Field,
    rng: np.random.Generator,
    roughness: float,
) -> Surface:
    """Return the surface with its hollows darkened, as skylight leaves them."""
    size_px = len(height)
    near, wide = (
        fields.occlusion(height, size_px / 300),
        fields.occlusion(height, size_px / 80),
    )
    rough = roughness + 0.04 * fields.grains(size_px, rng, 2.0)
    return Surface(
        np.clip(color * np.sqrt(near * wide)[..., None], 0, 1),
        height,
        np.clip(rough, 0, 1).astype(np.float32),
    )
