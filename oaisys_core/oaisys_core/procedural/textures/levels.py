"""Mipmaps of a texture set: each level has half the resolution of the one before.

Detail below the size of a pixel causes noise and costs memory bandwidth. The mean appearance is
preserved: colours are averaged in linear light, and averaged normals become flatter and the colour
a little darker, because the facets of rough ground turn away from the light.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb, linear
from oaisys_core.procedural.textures.normal_maps import decode_normals, encode_normals
from oaisys_core.scene.terrain_material import PbrMaps

MIN_PX = 8
"""Smallest edge length of a level."""

Image = NDArray[np.float32]


def levels_of(maps: PbrMaps) -> tuple[PbrMaps, ...]:
    """Return a texture set and its smaller levels.

    Backends use only the horizontal components of normals; those of the result are scaled for
    that.
    """
    result = [maps]
    color = linear(np.arange(256) / 255).astype(np.float32)[maps.color_srgb]
    facing = _facing(maps.normal_gl)
    height, roughness = maps.height, maps.roughness
    while (size := len(color) // 2) >= MIN_PX:
        color, facing = _smaller(color, size), _smaller(facing, size)
        height = _smaller(height, size)
        # Subsample instead of averaging: puddles must not become uniformly damp ground.
        roughness = _subsample(roughness, size)
        flatness = np.linalg.norm(facing, axis=-1, keepdims=True)
        result.append(
            replace(
                maps,
                color_srgb=encode_srgb(color * flatness),
                height=height,
                normal_gl=encode_normals(np.clip(facing / facing[..., 2:], -1, 1)),
                roughness=roughness,
            )
        )
    return tuple(result)


def level_at(maps: PbrMaps, levels: int, footprint_m: float) -> int:
    """Return the coarsest level whose texels are not larger than a pixel's footprint."""
    texel_m = maps.tile_m / len(maps.color_srgb)
    # Footprints are texels times powers of two, except for rounding.
    level = int(np.floor(np.log2(footprint_m / texel_m) + 1e-6))
    return min(max(level, 0), levels - 1)


def _facing(normal_gl: NDArray[np.uint8]) -> Image:
    """Return unit normals with the horizontal components of a normal map as slopes."""
    lean = decode_normals(normal_gl)
    lean[..., 2] = 1
    return np.asarray(lean / np.linalg.norm(lean, axis=-1, keepdims=True))


def _smaller(image: Image, size_px: int) -> Image:
    resized = cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_AREA)
    return np.asarray(resized, np.float32)


def _subsample(image: NDArray[np.uint8], size_px: int) -> NDArray[np.uint8]:
    resized = cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized, np.uint8)
