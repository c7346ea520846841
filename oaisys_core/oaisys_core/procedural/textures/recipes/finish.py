"""The result of texture recipes, and the steps that they share: tones, shading, albedo."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.color import LUMINANCE, linear, srgb
from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields

Color = tuple[float, float, float]
"""sRGB or, where a name says so, linear reflectance of red, green and blue; 0 to 1."""

PAINTED_PX, BAKED_PX = 1024, 2048
"""Edge length of maps that are painted from noise, and of those that are baked from geometry."""

MOST_AVERAGED_PX = 512
"""Edge length up to which `from_finer_texels` averages."""

_SRGB_OF_ROOT = srgb(np.square(np.linspace(0, 1, 8192)).astype(np.float32))
"""sRGB values by the square root of linear ones, which are closer together where it is dark."""


class TextureMaps(NamedTuple):
    """The maps that a recipe makes, before conversion to `PbrMaps`.

    Attributes:
        color: (N, N, 3) float32 sRGB, 0 to 1.
        height: (N, N) float32 in tile edges.
        roughness: (N, N) float32, 0 to 1.
        stones: (N, N) uint32 number of the stone that a pixel shows, from 1; 0 is the ground
            between them. None if it shows none.
    """

    color: NDArray[np.float32]
    height: Field
    roughness: Field
    stones: NDArray[np.uint32] | None = None


Make = Callable[[int, np.random.Generator], TextureMaps]
"""Function of (size_px, rng) that makes the maps of a set."""


class Recipe(NamedTuple):
    """The recipe of a texture set, and its size in the world.

    Attributes:
        make: Function of (size_px, rng) that makes its maps.
        tile_m: Edge length of a tile.
        albedo: Natural range of the mean linear luminance of such ground.
        subsurface: See `PbrMaps`.
        exposure: Where such ground lies: 1 on ridges and scarps as bare rock, -1 in hollows and on
            level ground as what wind and water carry.
        has_stones: Whether its maps tell its stones from the ground.
        stands_out: Whether its forms are so large that their repetition from tile to tile is seen.
        size_px: Edge length of its maps unless another one is asked for.
    """

    make: Make
    tile_m: float
    albedo: tuple[float, float]
    subsurface: float = 0.0
    exposure: float = 0.0
    has_stones: bool = False
    stands_out: bool = False
    size_px: int = PAINTED_PX


def from_finer_texels(make: Make) -> Make:
    """Return a recipe whose small maps are averages of larger ones.

    Things that are narrower than a texel would be seen or missed by chance.
    """

    @wraps(make)
    def made(size_px: int, rng: np.random.Generator) -> TextureMaps:
        if size_px > MOST_AVERAGED_PX:
            return make(size_px, rng)
        fine = make(2 * size_px, rng)
        color = linear(fine.color).astype(np.float32)
        return TextureMaps(
            linear_to_srgb(_halved(color)), _halved(fine.height), _halved(fine.roughness)
        )

    return made


def _halved(image: NDArray[np.float32]) -> NDArray[np.float32]:
    import cv2

    size = (len(image) // 2,) * 2
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def linear_to_srgb(value: ArrayLike) -> NDArray[np.float32]:
    """Return the sRGB values, 0 to 1, of linear ones (IEC 61966-2-1), within 0.1 of a byte."""
    root = np.sqrt(np.clip(np.asarray(value, np.float32), 0, 1))
    place = np.rint(root * np.float32(len(_SRGB_OF_ROOT) - 1)).astype(np.uint16)
    return np.asarray(_SRGB_OF_ROOT[place])


def scale_to_albedo(color: NDArray[np.float32], albedo: float) -> None:
    """Scale (N, N, 3) linear reflectance in place, so that its mean luminance is ``albedo``."""
    color *= np.float32(albedo / float((color @ np.array(LUMINANCE, np.float32)).mean()))


def tint(tone: Field, color: Color) -> NDArray[np.float32]:
    """Return (N, N, 3) of one colour, multiplied by ``tone``."""
    return np.asarray(tone[..., None] * np.array(color, np.float32), np.float32)


def blend(
    below: NDArray[np.float32], above: ArrayLike, share: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return (N, N, 3) colours, interpolated with (N, N) ``share`` from 0 to 1."""
    return np.asarray(below + (np.asarray(above, np.float32) - below) * share[..., None])


def smoothstep(low: float, high: float, value: Field) -> Field:
    """Return a smooth step from 0 at ``low`` to 1 at ``high``, which may be less than ``low``."""
    t = np.clip((value - np.float32(low)) / np.float32(high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)


def finish_maps(
    reflectance: NDArray[np.float32],
    height: Field,
    roughness: Field,
    *,
    albedo: float,
    shade: float = 0.5,
) -> TextureMaps:
    """Return the maps with a given mean albedo, and with hollows darkened by occlusion.

    Args:
        reflectance: (N, N, 3) linear colour with any mean.
        height: (N, N) in tile edges.
        roughness: (N, N) of 0 to 1.
        albedo: Mean linear luminance of the result.
        shade: Exponent of the darkening; 0 for none.
    """
    size_px = len(height)
    height = height.astype(np.float32)
    light = fields.occlusion(height, size_px / 300) * fields.occlusion(height, size_px / 80)
    color = np.clip(reflectance, 0, None) * np.power(light, np.float32(shade))[..., None]
    scale_to_albedo(color, albedo)
    return TextureMaps(linear_to_srgb(color), height, np.clip(roughness, 0, 1).astype(np.float32))
