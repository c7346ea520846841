"""Ground with stones: how they are poured on a tile, and their colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.ground import fine_noises, sky_share, swell
from oaisys_core.procedural.textures.baking.sizes import SizeLaw, draw_diameters
from oaisys_core.procedural.textures.baking.stamps import MeshStamps
from oaisys_core.procedural.textures.recipes.finish import Color, TextureMaps, linear_to_srgb

BRIGHTNESS = 0.2
"""Standard deviation of the logarithm of the brightness of stones of one kind."""

HOLLOWS = (1 / 300, 1 / 80)
"""Radii, in tile edges, of the surroundings that take away light; see `sky_share`."""

CHIPS_M = 0.0006
"""Standard deviation of the heights by which a stone's surface is uneven."""


class StoneBed(NamedTuple):
    """What stones lie in.

    Attributes:
        height: (N, N) in tile edges.
        shade: (N, N) factor on its linear colour.
        color: Of its dust and fines, sRGB.
    """

    height: Field
    shade: Field
    color: Color


def pour(
    bed: Bed,
    tile_m: float,
    stamps: MeshStamps,
    law: SizeLaw,
    cover: float,
    limits_m: tuple[float, float],
    laying: Laying,
    rng: np.random.Generator,
    density: Field | None = None,
) -> None:
    """Add stones to a bed.

    Args:
        bed: The bed.
        tile_m: Edge length of its tile.
        stamps: Shapes of the stones.
        law: Of their sizes in metres.
        cover: See `draw_diameters`.
        limits_m: Least and largest diameter.
        laying: How they are laid.
        rng: Draws them.
        density: See `Bed.add`.
    """
    diameters_m = draw_diameters(law, cover * tile_m**2, limits_m, rng)
    bed.add(stamps, diameters_m / tile_m, laying, rng, density)


def stone_maps(
    ground: StoneBed,
    bed: Bed,
    tile_m: float,
    tones: Sequence[Color],
    rng: np.random.Generator,
    roughness: float,
) -> TextureMaps:
    """Return the maps of a bed; each stone has its own tone, with dust around its foot.

    Args:
        ground: What was below the stones.
        bed: The stones.
        tile_m: Edge length of the tile.
        tones: Colours of kinds of stone, sRGB.
        rng: Draws which stone is of which kind, and the grain of all surfaces.
        roughness: Mean of the roughness.
    """
    size_px = len(bed.height)
    grain, uneven = fine_noises(size_px, rng)
    # Dust covers the foot of a stone, and thinly all of it.
    bare = np.clip(bed.above * 3 + 0.25 * uneven, 0, 1) * np.float32(0.88) * (bed.ids >= 0)
    below = ground.shade * (1 + 0.10 * grain + 0.06 * swell(size_px, 5, rng)) * (1 - bare)
    own = bare * (1 + 0.08 * grain + 0.09 * uneven)
    color = _tones(tones, bed.count, rng)[bed.ids]
    color *= own[..., None]
    color += below[..., None] * _linear(ground.color)
    height = bed.height + np.float32(CHIPS_M / tile_m) * (0.6 * uneven + 0.25 * grain)
    light, warm = sky_share(height, HOLLOWS), 0.02 * swell(size_px, 2, rng)
    color *= np.stack([light * (1 + part * warm) for part in (0.6, 0.0, -1.0)], axis=-1)
    rough = roughness + 0.03 * uneven + 0.05 * (1 - bare)
    return TextureMaps(
        linear_to_srgb(color),
        height.astype(np.float32),
        np.clip(rough, 0, 1).astype(np.float32),
        (bed.ids + 1).astype(np.uint32),
    )


def _tones(tones: Sequence[Color], count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return (count + 1, 3) linear colours; the last one is of no stone."""
    kinds = _linear(tones)[rng.integers(len(tones), size=count + 1)]
    bright = np.exp(rng.normal(0, BRIGHTNESS, (count + 1, 1)).clip(-0.6, 0.5))
    return np.asarray(kinds * bright, np.float32)


def _linear(color: Color | Sequence[Color]) -> NDArray[np.float32]:
    return np.asarray(linear(np.array(color, np.float64)), np.float32)
