"""Relief of textures as relief of the ground itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray
from oaisys_core.world.terrain_material import TerrainLayer, TerrainMaterial

ROWS = 128
"""Rows of the ground that are moved at once."""


def displaced(
    ground: HeightField, material: TerrainMaterial, reliefs_m: Sequence[float]
) -> HeightField:
    """Return a ground whose vertices are moved up and down by its layers' height maps.

    What is finer than the distance of vertices is left out, as it cannot be carried; the mean
    height stays.

    Args:
        ground: What to move.
        material: Its layers, whose weights mix their relief.
        reliefs_m: By layer, the height that the height map's full range stands for.
    """
    heights = [_carried(layer, ground.spacing_m) for layer in material.layers]
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


def _carried(layer: TerrainLayer, spacing_m: float) -> NDArray[np.float32]:
    """Return a layer's height map around 0, as fine as the ground's vertices stand."""
    height = layer.maps.height
    size = max(round(layer.maps.tile_m / spacing_m), 1)
    if size < len(height):
        resized = cv2.resize(height, (size, size), interpolation=cv2.INTER_AREA)
        height = np.asarray(resized, np.float32).reshape(size, size)
    return np.asarray(height - height.mean(), np.float32)


def _height_at(layer: TerrainLayer, height: NDArray[np.float32], xy_m: FloatArray) -> FloatArray:
    """Return (N,) heights of a map that lies on the ground as the layer's tiling says."""
    samples = layer.tiling.samples(xy_m / layer.maps.tile_m)
    result = np.zeros(len(xy_m))
    for places, weights in zip(samples.uv_tiles, samples.weights, strict=True):
        result += weights * _bilinear(height, places)
    return result


def _bilinear(height: NDArray[np.float32], places: FloatArray) -> FloatArray:
    """Return (N,) values of a map, row 0 at its top, at texture coordinates that repeat."""
    size = len(height)
    texel = places * size - 0.5
    low = np.floor(texel)
    s, t = (texel - low).T
    column, row = low.astype(np.int64).T
    c0, c1 = column % size, (column + 1) % size
    r0, r1 = size - 1 - row % size, size - 1 - (row + 1) % size
    lower = height[r0, c0] * (1 - s) + height[r0, c1] * s
    upper = height[r1, c0] * (1 - s) + height[r1, c1] * s
    return np.asarray(lower * (1 - t) + upper * t)
