"""Displacement of the ground's vertices by the height maps of its textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import HeightField
from oaisys_core.scene.terrain_material import TerrainLayer, TerrainMaterial
from oaisys_core.types import FloatArray

ROWS = 128
"""Rows of the ground that are processed at once."""


def displace(
    ground: HeightField, material: TerrainMaterial, reliefs_m: Sequence[float]
) -> HeightField:
    """Return the ground displaced by the height maps of its layers.

    Relief finer than the vertex spacing is filtered out; the mean height does not change.

    Args:
        ground: The ground before displacement.
        material: Its layers; their weights blend the relief.
        reliefs_m: For each layer, the height of the full range of its height map.
    """
    heights = [_filter_height(layer, ground.spacing_m) for layer in material.layers]
    elevation_m = ground.elevation_m.astype(np.float64)
    vertices = ground.vertices_m().reshape(*elevation_m.shape, 3)
    for first in range(0, len(elevation_m), ROWS):
        rows = slice(first, first + ROWS)
        xy_m = vertices[rows, :, :2].reshape(-1, 2).astype(np.float64)
        weights = material.weights_at(xy_m)
        moved_m = np.zeros(len(xy_m))
        for index, (layer, height) in enumerate(zip(material.layers, heights, strict=True)):
            if reliefs_m[index]:
                moved_m += weights[:, index] * reliefs_m[index] * _height_at(layer, height, xy_m)
        elevation_m[rows] += moved_m.reshape(-1, elevation_m.shape[1])
    return replace(ground, elevation_m=elevation_m.astype(np.float32))


def _filter_height(layer: TerrainLayer, spacing_m: float) -> NDArray[np.float32]:
    """Return the height map of a layer, with mean 0, at the resolution of the vertices."""
    import cv2

    height = layer.maps.height
    size = max(round(layer.maps.tile_m / spacing_m), 1)
    if size < len(height):
        resized = cv2.resize(height, (size, size), interpolation=cv2.INTER_AREA)
        height = np.asarray(resized, np.float32).reshape(size, size)
    return np.asarray(height - height.mean(), np.float32)


def _height_at(layer: TerrainLayer, height: NDArray[np.float32], xy_m: FloatArray) -> FloatArray:
    """Return (N,) heights of a map at points of the ground, with the layer's tiling."""
    samples = layer.tiling.samples(xy_m / layer.maps.tile_m)
    result = np.zeros(len(xy_m))
    for uv_tiles, weights in zip(samples.uv_tiles, samples.weights, strict=True):
        result += weights * _bilinear(height, uv_tiles)
    return result


def _bilinear(height: NDArray[np.float32], uv_tiles: FloatArray) -> FloatArray:
    """Return (N,) interpolated values of a repeating map, row 0 at its top."""
    size = len(height)
    texel = uv_tiles * size - 0.5
    low = np.floor(texel)
    s, t = (texel - low).T
    column, row = low.astype(np.int64).T
    c0, c1 = column % size, (column + 1) % size
    r0, r1 = size - 1 - row % size, size - 1 - (row + 1) % size
    lower = height[r0, c0] * (1 - s) + height[r0, c1] * s
    upper = height[r1, c0] * (1 - s) + height[r1, c1] * s
    return np.asarray(lower * (1 - t) + upper * t)
