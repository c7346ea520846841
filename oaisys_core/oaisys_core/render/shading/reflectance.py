"""Reflectance of the surface where beams of light meet it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.procedural.textures.borders import gumbel_heights, relief_weights
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.shading.shading import Palette
from oaisys_core.scene import PbrMaps, Scene, TerrainLayer
from oaisys_core.types import FloatArray

Image = NDArray[np.float32]

LINEAR = linear(np.arange(256) / 255).astype(np.float32)
"""Linear values of bytes in sRGB."""


class TextureLevels(NamedTuple):
    """A texture, and its averages over 2, 4, ... texels.

    Attributes:
        texels: (S, S, 2) reflectance and height (see `borders`) of each texel, by level.
        height_variances: Of the heights, by level.
    """

    texels: list[Image]
    height_variances: FloatArray


class Reflectance:
    """Looks up the textures of the ground, and the images of meshes from files.

    All other objects have the mean colour of theirs.

    The reflectance is the mean of red, green and blue of the linear albedo. Textures are averaged
    over the width of a beam. Where layers of the ground meet, the border follows their relief, as
    in the picture.
    """

    def __init__(self, scene: Scene) -> None:
        self._textures: dict[int, tuple[PbrMaps, TextureLevels]] = {}
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

    def at(self, view: View, width_m: FloatArray, surface: Surface | None = None) -> FloatArray:
        """Return the (N,) reflectance of a view of one column, 0 where nothing was hit.

        Args:
            view: What N rays see.
            surface: Which they were cast at; None: only the ground's reflectance is wanted.
            width_m: (N,) widths of the beams where they meet the surface.
        """
        found = np.zeros(len(view.depth_m))
        on_object = np.flatnonzero(view.instance_ids[:, 0] > 0)
        if len(on_object) and surface is not None:
            albedo = self._palette.albedo_of_objects(view.rows(on_object), surface)
            found[on_object] = albedo[:, 0].mean(axis=1)
        ground = np.flatnonzero(view.is_ground[:, 0])
        if len(ground):
            found[ground] = self._of_ground(view.points_m[ground, 0, :2], width_m[ground])
        return found

    def _of_ground(self, xy_m: FloatArray, width_m: FloatArray) -> FloatArray:
        """Return the (N,) reflectance of the ground at (N, 2) points."""
        material = self._scene.material
        weights = material.weights_at(xy_m)
        texels, heights, variances = (np.zeros(weights.shape) for _ in range(3))
        for index, layer in enumerate(material.layers):
            seen = np.flatnonzero(weights[:, index] > 0)
            found = self._of_layer(layer, xy_m[seen], width_m[seen])
            texels[seen, index], heights[seen, index], variances[seen, index] = found.T
        mixed = np.flatnonzero((weights > 0).sum(axis=1) > 1)
        weights[mixed] = relief_weights(weights[mixed], heights[mixed], variances[mixed])
        of_ground = np.einsum("nl,nl->n", weights, texels)
        if material.macro is not None:
            of_ground *= material.macro.factors_at(xy_m).mean(axis=1)
        return np.asarray(of_ground)

    def _of_layer(self, layer: TerrainLayer, xy_m: FloatArray, width_m: FloatArray) -> FloatArray:
        """Return (N, 3): reflectance, height, and variance of the heights of the texture there."""
        levels = self._levels(layer.maps)
        texel_m = layer.maps.tile_m / len(levels.texels[0])
        finest = np.log2(np.maximum(width_m / texel_m, 1.0))
        chosen = np.minimum(finest.astype(np.intp), len(levels.texels) - 1)
        samples = layer.tiling.samples(xy_m / layer.maps.tile_m)
        found = np.zeros((len(xy_m), 3))
        found[:, 2] = levels.height_variances[chosen]
        for level in np.unique(chosen):
            rows = np.flatnonzero(chosen == level)
            for uv_tiles, weights in zip(samples.uv_tiles, samples.weights, strict=True):
                texels = _texels(levels.texels[level], uv_tiles[rows])
                found[rows, :2] += weights[rows, None] * texels
        return found

    def _levels(self, maps: PbrMaps) -> TextureLevels:
        if id(maps) not in self._textures:
            reflectance = LINEAR[maps.color_srgb].mean(axis=-1)
            texels = [np.stack((reflectance, gumbel_heights(maps.height)), axis=-1)]
            while (size := len(texels[-1]) // 2) > 0:
                finer = texels[-1][: 2 * size, : 2 * size]
                texels.append(finer.reshape(size, 2, size, 2, 2).mean(axis=(1, 3)))
            variances = np.array([each[..., 1].var() for each in texels], np.float64)
            self._textures[id(maps)] = maps, TextureLevels(texels, variances)
        return self._textures[id(maps)][1]


def _texels(image: Image, uv_tiles: FloatArray) -> Image:
    """Return the (N, 2) texels at (N, 2) coordinates; row 0 of the image is the top of a tile."""
    size = len(image)
    within = uv_tiles - np.floor(uv_tiles)
    columns = np.minimum((within[:, 0] * size).astype(np.intp), size - 1)
    rows = np.minimum(((1 - within[:, 1]) * size).astype(np.intp), size - 1)
    return np.asarray(image[rows, columns])
