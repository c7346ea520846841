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
from oaisys_core.render.draft.ground.texture_atlas import TextureAtlas
from oaisys_core.render.shading.shading import mean_color
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene.terrain_material import PbrMaps, TerrainLayer
from oaisys_core.scene.tiling import Tiling
from oaisys_core.types import FloatArray

Levels = NDArray[np.intp]

_LINEAR = linear(np.arange(256) / 255)
_HEIGHTS = np.linspace(MIN_HEIGHT, MAX_HEIGHT, 256)
LINEAR = np.stack((_LINEAR, _LINEAR, _LINEAR, _HEIGHTS), axis=-1).astype(np.float32)[None]
"""Linear values of bytes in sRGB, and heights (see `borders`) of those in the last channel."""


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
        self._colors = TextureAtlas(colors)
        self._reliefs = TextureAtlas([_relief(each) for each in levels])
        self.mean = np.array(mean_color(levels[-1]), np.float32)

    def look_up(
        self, place_m: FloatArray, level: Levels, tiling: Tiling
    ) -> tuple[LayerLook, Floats]:
        """Return what the texture shows at (N, 2) places in a plane, and its heights."""
        samples = tiling.samples(place_m / self.maps.tile_m)
        of_layer = self.level_of.take(level)
        texels, reliefs = [], []
        for uv_tiles in samples.uv_tiles:
            places = self._colors.places(uv_tiles, of_layer)
            texels.append(self._colors.look_up(places, LINEAR))
            reliefs.append(self._reliefs.look_up(places).astype(np.float32))
        weights = samples.weights.astype(np.float32)
        if samples.turns_rad is not None:
            _turn(reliefs, samples.turns_rad)
        texel, relief = texels[0], reliefs[0]
        if len(texels) > 1:
            gain = 1 / np.sqrt((weights * weights).sum(axis=0))[:, None]
            texel = _blend(texels, weights)
            texel[:, :3] = np.maximum(self.mean + gain * (texel[:, :3] - self.mean), 0)
            relief = _blend(reliefs, weights)
            relief[:, :2] = FLAT + gain * (relief[:, :2] - FLAT)
        slope = (relief[:, :2] - np.float32(FLAT)) * np.float32(1 / STEPS)
        plane = LayerLook(texel[:, :3], slope, relief[:, 2] * np.float32(1 / 255))
        return plane, texel[:, 3]


def _relief(maps: PbrMaps) -> NDArray[np.uint8]:
    """Return the (S, S, 4) encoded slopes, roughness, and nothing."""
    empty = np.zeros_like(maps.roughness)
    return np.dstack((maps.normal_gl[..., :2], maps.roughness, empty))


def _turn(reliefs: list[Floats], turns_rad: FloatArray) -> None:
    """Turn encoded slopes, in place, as textures were turned the other way."""
    for relief, turn_rad in zip(reliefs, turns_rad, strict=True):
        cos, sin = np.cos(turn_rad).astype(np.float32), np.sin(turn_rad).astype(np.float32)
        x, y = relief[:, 0] - FLAT, relief[:, 1] - FLAT
        relief[:, 0], relief[:, 1] = FLAT + cos * x + sin * y, FLAT - sin * x + cos * y


def _blend(parts: list[Floats], weights: Floats) -> Floats:
    total = parts[0] * weights[0, :, None]
    for part, weight in zip(parts[1:], weights[1:], strict=True):
        total += part * weight[:, None]
    return total
