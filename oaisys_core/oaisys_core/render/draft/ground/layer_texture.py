"""The texture of one layer of the ground, at all its levels of detail."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.procedural.textures.borders import MAX_HEIGHT, MIN_HEIGHT
from oaisys_core.procedural.textures.levels import level_at
from oaisys_core.procedural.textures.normal_maps import FLAT, STEPS
from oaisys_core.render.draft.appearance import Floats
from oaisys_core.render.draft.ground.texture_atlas import Levels, TextureAtlas
from oaisys_core.render.shading.shading import mean_color
from oaisys_core.render.shading.texture_blend import (
    contrast_gain,
    mean_of_lookups,
    restore_contrast,
)
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene.terrain_material import PbrMaps, TerrainLayer
from oaisys_core.scene.tiling import PlainTiling, TextureSamples, Tiling
from oaisys_core.types import FloatArray

_LINEAR = linear(np.arange(256) / 255)
_HEIGHTS = np.linspace(MIN_HEIGHT, MAX_HEIGHT, 256)
LINEAR = np.stack((_LINEAR, _LINEAR, _LINEAR, _HEIGHTS)).astype(np.float32)
"""Linear values of bytes in sRGB, and heights (see `borders`) of those in the last channel."""

_SLOPES = (np.arange(256) - FLAT) / STEPS
RELIEF = np.stack((_SLOPES, _SLOPES, np.arange(256) / 255)).astype(np.float32)
"""Slopes along u and v, and roughness, of bytes."""


class LayerLook(NamedTuple):
    """How layers look, projected onto one plane.

    Attributes:
        color: (N, 3) linear.
        slope: (N, 2) along u and v.
        roughness: (N,).
    """

    color: Floats
    slope: Floats
    roughness: Floats


class LayerTexture:
    """The levels of one layer's texture, by the ground's levels of detail."""

    def __init__(self, layer: TerrainLayer, store: LevelStore, seen_m: FloatArray) -> None:
        """Take over a layer.

        Args:
            layer: The layer.
            store: Computes levels.
            seen_m: Footprints at which the ground's levels begin.
        """
        maps = layer.maps
        levels = store.levels(maps)
        self.maps, self.tiling = maps, layer.tiling
        self.has_labels = layer.label_image is not None
        self.level_of = np.array([level_at(maps, len(levels), each) for each in seen_m.tolist()])
        self.variances = [store.heights(levels[level]).variance for level in self.level_of]
        colors = [np.dstack((each.color_srgb, store.heights(each).texels)) for each in levels]
        self._colors = TextureAtlas(colors, self.level_of)
        self._reliefs = TextureAtlas([_relief(each) for each in levels], self.level_of)
        self.mean = np.array(mean_color(levels[-1]), np.float32)

    def look_up(
        self, place_m: FloatArray, level: Levels, tiling: Tiling
    ) -> tuple[LayerLook, Floats]:
        """Return what the texture shows at (N, 2) places in a plane, and its heights."""
        place_tiles = place_m / self.maps.tile_m
        if isinstance(tiling, PlainTiling):
            texel, relief = self._sample(place_tiles, level)
        else:
            texel, relief = self._blend(tiling.samples(place_tiles), level)
        return LayerLook(texel[:, :3], relief[:, :2], relief[:, 2]), texel[:, 3]

    def _sample(self, uv_tiles: FloatArray, level: Levels) -> tuple[Floats, Floats]:
        """Return (N, 4) colours and heights, and (N, 3) slopes and roughness, decoded."""
        places = self._colors.places((uv_tiles[:, 0], uv_tiles[:, 1]), level)
        return self._colors.look_up(places, LINEAR), self._reliefs.look_up(places, RELIEF)

    def _blend(self, samples: TextureSamples, level: Levels) -> tuple[Floats, Floats]:
        """Return the same, blended of several samples, as contrasty as each of them."""
        looks = [self._sample(uv_tiles, level) for uv_tiles in samples.uv_tiles]
        if samples.turn is not None:
            _turn_back(looks[0][1], samples.turn)
        weights = samples.weights.astype(np.float32)
        gain = contrast_gain(weights)
        texel, relief = (mean_of_lookups(each, weights) for each in zip(*looks, strict=True))
        restore_contrast(texel, gain, self.mean)
        relief[:, :2] *= gain
        return texel, relief


def _relief(maps: PbrMaps) -> NDArray[np.uint8]:
    """Return the (S, S, 4) encoded slopes, roughness, and nothing."""
    empty = np.zeros_like(maps.roughness)
    return np.dstack((maps.normal_gl[..., :2], maps.roughness, empty))


def _turn_back(relief: Floats, turn: FloatArray) -> None:
    """Turn slopes, in place, the other way than their texture was turned."""
    cos, sin = turn.astype(np.float32)
    x, y = relief[:, 0].copy(), relief[:, 1]
    relief[:, 0] = cos * x + sin * y
    relief[:, 1] = cos * y - sin * x
