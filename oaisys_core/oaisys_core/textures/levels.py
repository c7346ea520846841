"""A texture set seen from farther and farther away: each level is half the size of the one before.

What is smaller than a pixel only makes pictures noisy, and takes memory out of the processor's
caches. A level looks on the whole as what it stands for: colours are means of light, and the
facets of rough ground, which turn away from the light by different angles, have become one that
is less rough and a little darker.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encoded, linear
from oaisys_core.world.terrain_material import PbrMaps

LEAST_PX = 8
"""Edge length below which a texture is not made smaller."""

Image = NDArray[np.float32]


def levels_of(maps: PbrMaps) -> tuple[PbrMaps, ...]:
    """Return a texture set and all smaller ones that stand for it.

    Backends lay normals on the ground by their horizontal parts alone; those of the result are
    meant for that too.
    """
    result = [maps]
    color = linear(np.arange(256) / 255).astype(np.float32)[maps.color_srgb]
    facing = _facing(maps.normal_gl)
    height, roughness = maps.height, maps.roughness
    while (size := len(color) // 2) >= LEAST_PX:
        color, facing = _smaller(color, size), _smaller(facing, size)
        height = _smaller(height, size)
        # Some of it, not its mean: a ground with puddles is not a damp one.
        roughness = _some(roughness, size)
        flatness = np.linalg.norm(facing, axis=-1, keepdims=True)
        result.append(
            replace(
                maps,
                color_srgb=encoded(color * flatness),
                height=height,
                normal_gl=_coded(facing / facing[..., 2:]),
                roughness=roughness,
            )
        )
    return tuple(result)


def level_at(maps: PbrMaps, levels: int, footprint_m: float) -> int:
    """Return the coarsest of a set's levels whose texels are no larger than a footprint."""
    texel_m = maps.tile_m / len(maps.color_srgb)
    # Footprints are texels times powers of two, but for their last bits.
    level = int(np.floor(np.log2(footprint_m / texel_m) + 1e-6))
    return min(max(level, 0), levels - 1)


def _facing(normal_gl: NDArray[np.uint8]) -> Image:
    """Return the unit normals of ground that leans by the horizontal parts of a normal map."""
    lean = np.arange(256, dtype=np.float32)[normal_gl] / np.float32(127.5) - 1
    lean[..., 2] = 1
    return np.asarray(lean / np.linalg.norm(lean, axis=-1, keepdims=True))


def _coded(lean: Image) -> NDArray[np.uint8]:
    return np.asarray(np.rint((lean + 1) * np.float32(127.5)), np.uint8)


def _smaller(image: Image, size_px: int) -> Image:
    resized = cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_AREA)
    return np.asarray(resized, np.float32)


def _some(image: NDArray[np.uint8], size_px: int) -> NDArray[np.uint8]:
    resized = cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized, np.uint8)
