"""Recipes of the built-in texture sets: what the ground is made of, seen from above."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.terrain.noise import Field
from oaisys_core.textures import fields
from oaisys_core.textures.fields import Stones

Color = tuple[float, float, float]
"""sRGB, 0 to 1."""


class Surface(NamedTuple):
    """A recipe's result.

    Attributes:
        color: (N, N, 3) float32 sRGB, 0 to 1.
        height: (N, N) float32, any range.
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
        relief_m: Difference between its lowest and highest point.
    """

    make: Callable[[int, np.random.Generator], Surface]
    tile_m: float
    relief_m: float


GRAVEL_STONES: tuple[Color, ...] = (
    (0.47, 0.42, 0.37),
    (0.55, 0.49, 0.42),
    (0.38, 0.35, 0.33),
    (0.62, 0.56, 0.48),
    (0.44, 0.36, 0.30),
    (0.52, 0.50, 0.48),
)
DUST: Color = (0.53, 0.45, 0.36)


def gravel(size_px: int, rng: np.random.Generator) -> Surface:
    """Stones of 2 to 25 cm, lying close, dust between them."""
    base = 0.05 * fields.tile_noise(size_px, 6, rng, octaves=6)
    color = _dusty(size_px, rng, DUST, 0.10)
    height = base
    for cells, cover, radius in (
        (72, 0.9, (0.3, 0.62)),
        (30, 0.62, (0.3, 0.6)),
        (12, 0.4, (0.25, 0.5)),
    ):
        layer = fields.stones(size_px, cells, rng, cover, radius)
        height, color = _lay(height, color, layer, 1.0 / cells, GRAVEL_STONES, rng)
    return _lit(size_px, height, color, rng, roughness=0.86)


def sand(size_px: int, rng: np.random.Generator) -> Surface:
    """Fine sand with faint ripples and a few pebbles."""
    x, y = fields.unit_grid(size_px, 4)
    wx, wy = fields.warped_tile(x, y, rng)
    ripples = np.sin(2 * np.pi * (5 * wx + 2 * wy)).astype(np.float32)
    patches = fields.tile_noise(size_px, 3, rng, octaves=5)
    height = 0.0022 * ripples * np.clip(patches + 0.4, 0, 1) + 0.02 * patches
    height += 0.0006 * fields.grains(size_px, rng, 0.8)
    color = _dusty(size_px, rng, (0.66, 0.56, 0.43), 0.06)
    color *= (1 + 0.05 * patches)[..., None]
    for cells, cover in ((60, 0.07), (26, 0.05)):
        layer = fields.stones(size_px, cells, rng, cover, (0.15, 0.42))
        height, color = _lay(height, color, layer, 0.7 / cells, GRAVEL_STONES, rng)
    return _lit(size_px, height, color, rng, roughness=0.93)


def regolith(size_px: int, rng: np.random.Generator) -> Surface:
    """Grey powder with clods and angular fragments, as on the Moon."""
    lumps = fields.tile_noise(size_px, 5, rng, octaves=7)
    height = 0.03 * lumps + 0.001 * fields.grains(size_px, rng, 0.9)
    color = _dusty(size_px, rng, (0.42, 0.41, 0.39), 0.07)
    color *= (1 + 0.10 * lumps)[..., None]
    tones: tuple[Color, ...] = ((0.40, 0.39, 0.38), (0.48, 0.47, 0.45), (0.34, 0.33, 0.33))
    for cells, cover in ((80, 0.22), (34, 0.14), (13, 0.08)):
        layer = fields.stones(size_px, cells, rng, cover, (0.2, 0.55))
        height, color = _lay(height, color, layer, 0.8 / cells, tones, rng)
    return _lit(size_px, height, color, rng, roughness=0.95)


def soil(size_px: int, rng: np.random.Generator) -> Surface:
    """Dry, crusted earth with hairline cracks and small stones."""
    clods = fields.tile_noise(size_px, 7, rng, octaves=7)
    split = fields.cracks(size_px, 14, rng, width=0.06)
    crust = np.clip(fields.tile_noise(size_px, 3, rng, octaves=4) * 2 + 0.4, 0, 1)
    height = 0.03 * clods - 0.012 * split * crust + 0.001 * fields.grains(size_px, rng, 1.0)
    color = _dusty(size_px, rng, (0.45, 0.35, 0.27), 0.09)
    color *= (1 + 0.16 * clods - 0.35 * split * crust)[..., None]
    for cells, cover in ((90, 0.18), (36, 0.12)):
        layer = fields.stones(size_px, cells, rng, cover, (0.2, 0.5))
        height, color = _lay(height, color, layer, 0.8 / cells, GRAVEL_STONES, rng)
    return _lit(size_px, height, color, rng, roughness=0.9)


def rock(size_px: int, rng: np.random.Generator) -> Surface:
    """Weathered rock: faint layers, pits, cracks, stains."""
    layers = fields.strata(size_px, 22, rng)
    ridges = fields.tile_noise(size_px, 6, rng, octaves=7, kind="ridged")
    rough = fields.tile_noise(size_px, 14, rng, octaves=6)
    # A crack runs only where the rock is weak, so that it ends somewhere.
    weak = np.clip(3 * fields.tile_noise(size_px, 4, rng, octaves=5) - 0.3, 0, 1)
    split = weak * fields.cracks(size_px, 6, rng, width=0.035)
    stains = np.clip(fields.tile_noise(size_px, 5, rng, octaves=7) * 2.2, -1, 1)
    pits = np.clip(fields.tile_noise(size_px, 40, rng, octaves=4) - 0.25, 0, 1)
    height = 0.010 * layers + 0.040 * ridges + 0.022 * rough - 0.02 * split - 0.03 * pits
    color = _dusty(size_px, rng, (0.47, 0.42, 0.37), 0.05)
    color *= (1 + 0.08 * layers + 0.25 * rough + 0.2 * (ridges - 0.6) - 0.3 * split)[..., None]
    color += np.float32(0.05) * stains[..., None] * np.array((1.0, 0.72, 0.45), np.float32)
    return _lit(size_px, height, color, rng, roughness=0.85)


RECIPES: dict[str, Recipe] = {
    "gravel": Recipe(gravel, tile_m=3.2, relief_m=0.11),
    "sand": Recipe(sand, tile_m=3.6, relief_m=0.05),
    "regolith": Recipe(regolith, tile_m=3.4, relief_m=0.09),
    "soil": Recipe(soil, tile_m=3.0, relief_m=0.07),
    "rock": Recipe(rock, tile_m=2.0, relief_m=0.09),
}


def _dusty(
    size_px: int, rng: np.random.Generator, color: Color, variation: float
) -> NDArray[np.float32]:
    """Return (N, N, 3) of one colour with fine and coarse variation of its brightness."""
    tone = 1 + variation * fields.grains(size_px, rng, 0.7)
    tone += variation * fields.tile_noise(size_px, 8, rng, octaves=6)
    return np.asarray(tone[..., None] * np.array(color, np.float32), np.float32)


def _lay(
    height: Field,
    color: NDArray[np.float32],
    layer: Stones,
    scale: float,
    tones: Sequence[Color],
    rng: np.random.Generator,
) -> tuple[Field, NDArray[np.float32]]:
    """Return height and colour with a layer of stones on top; each stone has a tone of its own."""
    count = int(layer.ids.max(initial=0)) + 1
    tone = np.array(tones, np.float32)[rng.integers(len(tones), size=count)]
    tone = tone * rng.normal(1.0, 0.13, (count, 1)).clip(0.6, 1.35).astype(np.float32)
    speckle = 1 + 0.07 * fields.grains(len(height), rng, 0.9)
    there = layer.ids >= 0
    stone = tone[layer.ids[there]] * speckle[there][:, None]
    rim = np.clip(layer.height[there] / np.float32(0.3), 0.45, 1)[:, None]
    laid = color.copy()
    laid[there] = stone * rim
    # Stones rest on what lies below them on average, not on every bump of it.
    ground = fields.blurred(height, 0.12 * scale * len(height))
    raised = height.copy()
    raised[there] = ground[there] + layer.height[there] * np.float32(scale)
    return raised, laid


def _lit(
    size_px: int,
    height: Field,
    color: NDArray[np.float32],
    rng: np.random.Generator,
    roughness: float,
) -> Surface:
    """Return the surface with its hollows darkened, as skylight leaves them."""
    near, wide = fields.occlusion(height, size_px / 170), fields.occlusion(height, size_px / 45)
    shade = near * wide
    rough = roughness + 0.04 * fields.grains(size_px, rng, 2.0)
    return Surface(
        np.clip(color * np.sqrt(shade)[..., None], 0, 1),
        height,
        np.clip(rough, 0, 1).astype(np.float32),
    )
