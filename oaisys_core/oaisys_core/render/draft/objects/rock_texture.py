"""The texture of rocks, projected from three sides as by Blender's box projection."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.render.draft.appearance import Floats, zeros
from oaisys_core.render.draft.ground.texture_atlas import LevelTable, TextureAtlas
from oaisys_core.render.draft.objects.object_meshes import LINEAR
from oaisys_core.render.shading.looks import BOX_BLEND, ROCK_BUMP_M
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene import PbrMaps
from oaisys_core.types import FloatArray

TABLE = np.stack([LINEAR] * 3)
"""The same for three channels."""

PLANES = ((1, 2), (0, 2), (1, 0))
"""Axes of u and v of the projections along x, y and z."""

FLIPPED = (-1, 1, 1)
"""Sign of the normal's component along each axis from which on u is mirrored."""


class RockPoints(NamedTuple):
    """What (N,) points show: colour, height 0 to 1, slope of the relief in 3D, and roughness."""

    color: Floats
    height: Floats
    slope: Floats
    roughness: Floats


class RockTexture:
    """One texture set on rocks."""

    def __init__(self, maps: PbrMaps, store: LevelStore) -> None:
        """Take over a texture set."""
        levels = store.levels(maps)
        self._tile_m = maps.tile_m
        texel_m = maps.tile_m / len(maps.color_srgb)
        self._bounds_m = np.array([texel_m * 2**step for step in range(1, len(levels))])
        self._colors = TextureAtlas([each.color_srgb for each in levels])
        self._reliefs = TextureAtlas([_relief(each.height, maps.tile_m) for each in levels])
        self._roughness = LevelTable([each.roughness.mean() / 255 for each in levels])

    def at(self, place_m: FloatArray, normal: Floats, footprint_m: Floats) -> RockPoints:
        """Return what (N, 3) points show.

        Args:
            place_m: In the rock's axes, shifted by its position.
            normal: (N, 3) in the same axes.
            footprint_m: (N,) sizes of a pixel there.
        """
        level = np.zeros(len(normal), np.uint8)
        for bound_m in self._bounds_m.astype(np.float32):
            level += footprint_m > bound_m
        weights = box_weights(normal)
        count = len(normal)
        color, slope, height = zeros(count, 3), zeros(count, 3), np.zeros(count, np.float32)
        tiles = place_m * (1 / self._tile_m)
        for axis, (u, v) in enumerate(PLANES):
            rows = np.flatnonzero(weights[:, axis])
            if not len(rows):
                continue
            part = weights[:, axis].take(rows)
            # -1 where u is mirrored.
            sign = np.where(normal[:, axis].take(rows) * FLIPPED[axis] > 0, -1, 1).astype(np.int8)
            along_u = tiles[:, u].take(rows)
            along_u *= sign
            along_u += sign < 0
            along_v = tiles[:, v].take(rows)
            places = self._colors.places((along_u, along_v), level.take(rows))
            for channel, seen in zip(color.T, self._colors.look_up(places, TABLE).T, strict=True):
                channel[rows] += part * seen
            relief = self._reliefs.look_up(places)
            height[rows] += part * relief[:, 2]
            slope[rows, u] += part * relief[:, 0] * sign
            slope[rows, v] += part * relief[:, 1]
        return RockPoints(color, height, slope, self._roughness.take(level))


def box_weights(normal: Floats) -> Floats:
    """Return (N, 3) weights of the projections along x, y and z at (N, 3) normals.

    One projection alone is seen where its share of the normal beside each other one is large; two
    are blended where the third is small, and all three in between.
    """
    size = np.abs(normal)
    total = size[:, 0] + size[:, 1] + size[:, 2]
    size = size / np.maximum(total, np.float32(1e-12))[:, None]
    limit = np.float32(0.5 * (1 + BOX_BLEND))
    weights = ((2 - limit) * size + (limit - 1)) / (2 * limit - 1)
    for third in range(3):
        first, second = (axis for axis in range(3) if axis != third)
        both = size[:, first] + size[:, second]
        pair = np.flatnonzero(size[:, third] < (1 - limit) * both)
        share = size[:, first].take(pair) / both.take(pair)
        share = np.clip((share - np.float32(0.5 * (1 - BOX_BLEND))) / np.float32(BOX_BLEND), 0, 1)
        weights[pair, first], weights[pair, second], weights[pair, third] = share, 1 - share, 0
    for axis in range(3):
        others = [size[:, axis] + size[:, other] for other in range(3) if other != axis]
        alone = (size[:, axis] > limit * others[0]) & (size[:, axis] > limit * others[1])
        for other in range(3):
            np.putmask(weights[:, other], alone, np.float32(other == axis))
    np.maximum(weights, 0, out=weights)
    return np.asarray(weights / (weights[:, 0] + weights[:, 1] + weights[:, 2])[:, None])


def _relief(height: NDArray[np.float32], tile_m: float) -> NDArray[np.float32]:
    """Return (S, S, 3) slopes along u and v of the bump that a height map stands for, and it."""
    per_m = ROCK_BUMP_M * len(height) / (2 * tile_m)
    # Row 0 is the top of a tile.
    along_u = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) * per_m
    along_v = (np.roll(height, 1, axis=0) - np.roll(height, -1, axis=0)) * per_m
    return np.asarray(np.stack((along_u, along_v, height), axis=-1), np.float32)
