"""Reflectance of the surface where beams of light meet it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.raycast.shading import Palette
from oaisys_core.backend.surface import View
from oaisys_core.color import linear
from oaisys_core.scene import PbrMaps, Scene, TerrainLayer
from oaisys_core.types import FloatArray

Image = NDArray[np.float32]

LINEAR = linear(np.arange(256) / 255).astype(np.float32)
"""Linear values of bytes in sRGB."""


class Reflectance:
    """Looks up the ground's textures; objects have the mean colour of theirs.

    The reflectance is the mean of red, green and blue of the linear albedo. Textures are averaged
    over the width of a beam.
    """

    def __init__(self, scene: Scene) -> None:
        self._textures: dict[int, tuple[PbrMaps, list[Image]]] = {}
        self._palette = Palette(scene)
        self._scene = scene

    @property
    def scene(self) -> Scene:
        """The scene that was taken over last."""
        return self._scene

    def update(self, scene: Scene) -> None:
        """Take over a changed scene; textures that were seen before are reused."""
        self._palette.update(scene)
        self._scene = scene

    def at(self, view: View, width_m: FloatArray) -> FloatArray:
        """Return the (N,) reflectance of a view of one column, 0 where nothing was hit.

        Args:
            view: What N rays see.
            width_m: (N,) widths of the beams where they meet the surface.
        """
        found = np.zeros(len(view.depth_m))
        on_object = np.flatnonzero(view.instance_ids[:, 0] > 0)
        if len(on_object):
            ids = view.instance_ids[on_object, 0]
            found[on_object] = self._palette.albedo_of_objects(ids).mean(axis=1)
        ground = np.flatnonzero(view.is_ground[:, 0])
        xy_m = view.points_m[ground, 0, :2]
        weights = self._scene.material.weights_at(xy_m)
        of_ground = np.zeros(len(ground))
        for layer, weight in zip(self._scene.material.layers, weights.T, strict=True):
            seen = np.flatnonzero(weight > 0)
            texture = self._of_layer(layer, xy_m[seen], width_m[ground[seen]])
            of_ground[seen] += weight[seen] * texture
        found[ground] = of_ground
        return np.asarray(found)

    def _of_layer(self, layer: TerrainLayer, xy_m: FloatArray, width_m: FloatArray) -> FloatArray:
        levels = self._levels(layer.maps)
        texel_m = layer.maps.tile_m / len(levels[0])
        finest = np.log2(np.maximum(width_m / texel_m, 1.0))
        chosen = np.minimum(finest.astype(np.intp), len(levels) - 1)
        samples = layer.tiling.samples(xy_m / layer.maps.tile_m)
        found = np.zeros(len(xy_m))
        for level in np.unique(chosen):
            rows = np.flatnonzero(chosen == level)
            for uv_tiles, weights in zip(samples.uv_tiles, samples.weights, strict=True):
                found[rows] += weights[rows] * _texels(levels[level], uv_tiles[rows])
        return found

    def _levels(self, maps: PbrMaps) -> list[Image]:
        """Return the reflectance of a texture, and of its averages over 2, 4, ... texels."""
        if id(maps) not in self._textures:
            levels = [LINEAR[maps.color_srgb].mean(axis=-1)]
            while (size := len(levels[-1]) // 2) > 0:
                finer = levels[-1][: 2 * size, : 2 * size]
                levels.append(finer.reshape(size, 2, size, 2).mean(axis=(1, 3)))
            self._textures[id(maps)] = (maps, levels)
        return self._textures[id(maps)][1]


def _texels(image: Image, uv_tiles: FloatArray) -> Image:
    """Return the texels at (N, 2) coordinates; row 0 of the image is the top of a tile."""
    size = len(image)
    within = uv_tiles - np.floor(uv_tiles)
    columns = np.minimum((within[:, 0] * size).astype(np.intp), size - 1)
    rows = np.minimum(((1 - within[:, 1]) * size).astype(np.intp), size - 1)
    return np.asarray(image[rows, columns])
