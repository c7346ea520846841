"""Displacement of the ground's vertices by the height maps of its textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.textures.normal_maps import decode_normals
from oaisys_core.scene import HeightField
from oaisys_core.scene.terrain_material import PbrMaps, TerrainLayer, TerrainMaterial
from oaisys_core.types import FloatArray

ROWS = 128
"""Rows of the ground that are processed at once."""

FITTED_ROWS = 512
"""Rows of a texture's maps of which its relief is found."""

LEAST_UPWARD = 0.05
"""Upward part of the steepest normal whose slope is taken as it is."""


@dataclass(frozen=True)
class LayerRelief:
    """The relief of the ground's textures, blended by the weights of their layers.

    Attributes:
        material: The layers.
        reliefs_m: For each layer, the height of the full range of its height map.
    """

    material: TerrainMaterial
    reliefs_m: tuple[float, ...]

    def on_grid(self, grid: HeightField) -> FloatArray:
        """Return the (rows, columns) heights at a grid's points, with mean 0.

        Relief finer than the grid's spacing is filtered out.
        """
        heights = [_filter_height(layer, grid.spacing_m) for layer in self.material.layers]
        y_m, x_m = (axis_m.astype(np.float64) for axis_m in grid.grid_m())
        blended_m = np.zeros(grid.elevation_m.shape)
        for first in range(0, len(y_m), ROWS):
            rows = slice(first, first + ROWS)
            xy_m = np.stack(np.meshgrid(x_m, y_m[rows]), axis=-1).reshape(-1, 2)
            blended_m[rows] = self._at(xy_m, heights).reshape(-1, len(x_m))
        return blended_m

    def _at(self, xy_m: FloatArray, heights: Sequence[NDArray[np.float32]]) -> FloatArray:
        """Return (N,) heights at (N, 2) points from the layers' filtered height maps."""
        weights = self.material.weights_at(xy_m)
        moved_m = np.zeros(len(xy_m))
        for index, layer in enumerate(self.material.layers):
            if self.reliefs_m[index]:
                height = _height_at(layer, heights[index], xy_m)
                moved_m += weights[:, index] * self.reliefs_m[index] * height
        return moved_m


def displace(ground: HeightField, relief: LayerRelief) -> HeightField:
    """Return the ground displaced by the relief of its textures; the mean height stays."""
    moved_m = ground.elevation_m.astype(np.float64) + relief.on_grid(ground)
    return replace(ground, elevation_m=moved_m.astype(np.float32))


def relief_of_maps(maps: PbrMaps) -> float:
    """Return the height in metres of the full range of a height map, from the normals beside it.

    It is the factor by which the slopes of the height map fit those of the normals best (least
    squares); 0 where one of the two maps is flat.
    """
    size = len(maps.height)
    rows = slice(0, min(size, FITTED_ROWS))
    height = maps.height[rows].astype(np.float64)
    right = np.gradient(height, axis=1)[1:-1, 1:-1] * (size / maps.tile_m)
    up = -np.gradient(height, axis=0)[1:-1, 1:-1] * (size / maps.tile_m)
    x, y, z = np.moveaxis(decode_normals(maps.normal_gl[rows])[1:-1, 1:-1], -1, 0)
    upward = np.maximum(z, LEAST_UPWARD).astype(np.float64)
    power = (right**2 + up**2).sum()
    fit = -((right * x + up * y) / upward).sum()
    return float(max(fit / power, 0.0)) if power else 0.0


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
