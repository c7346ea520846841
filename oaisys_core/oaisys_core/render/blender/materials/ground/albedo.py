"""The ground's albedo over the pixels of a view, as its material has it, but without noise.

Cycles looks textures up at one point of each sample, whose noise remains in the albedo of few
samples per pixel. Here, several points of each pixel are averaged, at the same level of detail.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.procedural.contact_map import ContactMap
from oaisys_core.procedural.terrain.macro_variation import MAX_FACTOR, MIN_FACTOR
from oaisys_core.procedural.textures.borders import (
    MAX_HEIGHT,
    MIN_HEIGHT,
    NEGLIGIBLE,
    LayerBorder,
    borders,
    keys,
    mix,
)
from oaisys_core.procedural.textures.levels import level_at
from oaisys_core.raycast.view import View, bands
from oaisys_core.render.blender.materials.ground.pixel_weights import (
    Image,
    bilinear,
    pixel_weights,
    places_on_stage,
)
from oaisys_core.render.blender.materials.ground.tiled_texels import (
    PixelLookups,
    pixel_lookups,
)
from oaisys_core.render.blender.materials.images import ImageStore
from oaisys_core.render.shading.looks import (
    VARIATION_TILES,
    VARIATION_TURN_RAD,
    footprints_m,
    is_glossy,
    varies,
)
from oaisys_core.render.shading.shading import in_haze, mean_color
from oaisys_core.render.shading.texture_blend import (
    contrast_gain,
    mean_of_lookups,
    restore_contrast,
)
from oaisys_core.scene.sky import Sky
from oaisys_core.scene.terrain_material import (
    MAX_TONE,
    MIN_TONE,
    STEEP_COS,
    PbrMaps,
    TerrainMaterial,
)
from oaisys_core.types import FloatArray

POINTS = ((-0.25, 0.083), (-0.083, -0.25), (0.083, 0.25), (0.25, -0.083))
"""Rows and columns of the points of a pixel that are averaged. No two share a row or a column, and
they are spread as widely as the samples of Cycles (`SAMPLED_WIDTH_PX`)."""

MAX_STEP = 1.2
"""Largest ratio of the distances of neighbouring pixels that see the same part of the ground."""

GENTLE_COS = STEEP_COS[0] + 0.03
"""Least vertical component of normals at which no texture is projected from the side."""

UNKNOWN = -1
"""Level of detail of pixels whose albedo is not computed."""

_HEIGHTS = np.linspace(MIN_HEIGHT, MAX_HEIGHT, 256)
LINEAR = np.stack((*[linear(np.arange(256) / 255)] * 3, _HEIGHTS), axis=-1)
LINEAR = LINEAR.astype(np.float32)[None]
"""Linear values of bytes in sRGB, and heights (see `borders`) of those in the last channel."""


class PixelAlbedo(NamedTuple):
    """Albedo where it is known.

    Attributes:
        linear: (H, W, 3) float32; as in Cycles, haze attenuates it, and its own light is added.
        is_known: (H, W) whether it was computed.
    """

    linear: Image
    is_known: NDArray[np.bool_]


class _Texels(NamedTuple):
    """A texture's (S, S, 4) bytes of colour and heights, and its (3,) mean linear colour."""

    image: NDArray[np.uint8]
    mean: Image


class GroundAlbedo:
    """Computes the albedo of the ground where its textures have no gloss.

    Attributes:
        contact: Where fines lie on the ground, whose albedo is not computed; None: nowhere.
    """

    contact: ContactMap | None = None

    def __init__(self, material: TerrainMaterial, images: ImageStore) -> None:
        """Take over a material whose nodes were made with ``images``."""
        self._material = material
        self._images = images
        self._levels = {id(each.maps): images.levels(each.maps) for each in material.layers}
        self._footprints_m = np.array(footprints_m(material))
        self._texels: dict[int, _Texels] = {}
        self._varies = varies(material)
        macro, self._macro = material.macro, None
        if macro is not None:
            self._macro = macro.share[::-1].astype(np.float32) / np.float32(255)
            self._macro_period_m = macro.period_m
        self._borders = [self._borders_at(level) for level in range(len(self._footprints_m))]
        self._is_dull = [not is_glossy(layer.maps) for layer in material.layers]

    @property
    def has_gloss(self) -> bool:
        """Whether a layer has, so that there are places whose albedo is not computed."""
        return not all(self._is_dull)

    def of_view(self, view: View, pixel_rad: float, sky: Sky) -> PixelAlbedo | None:
        """Return the albedo of a view; None if no layer of the ground has a known one.

        Args:
            view: What the pixels see.
            pixel_rad: Angle of a pixel that levels of detail are chosen by.
            sky: Whose haze is in front of the ground.
        """
        if not any(self._is_dull):
            return None
        height, width = view.depth_m.shape
        albedo = np.empty((height, width, 3), np.float32)
        is_known = np.empty((height, width), np.bool_)
        for rows in bands(height, width):
            # Slopes and steps of distance depend on the rows beside.
            first, end = max(rows.start - 1, 0), min(rows.stop + 1, height)
            part = self._of_rows(view.rows(slice(first, end)), pixel_rad, sky)
            wanted = slice(rows.start - first, rows.stop - first)
            albedo[rows], is_known[rows] = part.linear[wanted], part.is_known[wanted]
        return PixelAlbedo(albedo, is_known)

    def _of_rows(self, view: View, pixel_rad: float, sky: Sky) -> PixelAlbedo:
        points_m = np.where(view.is_ground[..., None], view.points_m, 0.0)
        distance_m = np.where(view.is_ground, view.depth_m, 0.0)
        distance_m *= np.linalg.norm(view.directions, axis=-1)
        xy_m = np.ascontiguousarray(points_m[..., :2])
        weights = pixel_weights(self._material, xy_m)
        is_known = _is_smooth(distance_m)
        if self._material.projects_sides:
            is_known &= _upward(points_m) > GENTLE_COS
        for weight, is_dull in zip(weights, self._is_dull, strict=True):
            is_known &= is_dull | (weight <= NEGLIGIBLE)
        if self.contact is not None:
            is_known &= ~self.contact.is_near(xy_m)
        level = np.searchsorted(self._footprints_m[1:], distance_m * pixel_rad)
        albedo = self._mix(xy_m, weights, np.where(is_known, level, UNKNOWN))
        if sky.haze is not None:
            clear = albedo[is_known].astype(np.float64)
            albedo[is_known] = in_haze(clear, distance_m[is_known], sky.haze, sky)
        return PixelAlbedo(albedo, is_known)

    def _mix(self, xy_m: FloatArray, weights: list[Image], level: NDArray[np.intp]) -> Image:
        """Return the (H, W, 3) colour of all layers where the level of detail is known."""
        color = np.zeros((*level.shape, 3), np.float32)
        row_m, column_m = np.gradient(xy_m, axis=(0, 1))
        for each in range(len(self._footprints_m)):
            pixels = level == each
            seen = np.flatnonzero(pixels.any(axis=1))
            if not len(seen):
                continue
            rows = slice(seen[0], seen[-1] + 1)
            of_rows = [weight[rows] for weight in weights]
            present = [bool((pixels[rows] & (each > NEGLIGIBLE)).any()) for each in of_rows]
            lookups = [
                pixel_lookups(layer.tiling, xy_m[rows] / layer.maps.tile_m) if is_present else None
                for layer, is_present in zip(self._material.layers, present, strict=True)
            ]
            mixed = np.zeros((*pixels[rows].shape, 3), np.float32)
            for down, right in POINTS:
                step_m = down * row_m[rows] + right * column_m[rows]
                if self._spans_masks(each):
                    of_rows = pixel_weights(self._material, xy_m[rows] + step_m)
                mixed += self._color(each, lookups, step_m, of_rows)
            mixed *= pixels[rows, :, None] / np.float32(len(POINTS))
            color[rows] += mixed * self._variation(each, xy_m[rows]) if self._varies else mixed
        tone = self._material.tone
        if tone is not None:
            places = places_on_stage(self._material, xy_m, len(tone.pixels))
            share = bilinear(tone.pixels, *places, cv2.BORDER_REPLICATE)
            color *= share * np.float32((MAX_TONE - MIN_TONE) / 255) + np.float32(MIN_TONE)
        if self._macro is not None:
            share = _texture(self._macro, xy_m / self._macro_period_m)
            color *= share * np.float32(MAX_FACTOR - MIN_FACTOR) + np.float32(MIN_FACTOR)
        return color

    def _spans_masks(self, level: int) -> bool:
        """Return whether pixels of a level may be wider than a texel of the layers' masks."""
        x0, _, x1, _ = self._material.extent_m
        widest_m = [*self._footprints_m[1:], inf][level]
        return len(self._material.layers) > 1 and widest_m * self._material.masks.shape[2] > x1 - x0

    def _color(
        self,
        level: int,
        lookups: list[PixelLookups | None],
        step_m: FloatArray,
        weights: list[Image],
    ) -> Image:
        """Return the (R, W, 3) colour at steps from the pixels' centres.

        Args:
            level: Of detail.
            lookups: Of each layer; None for those that are in none of these pixels.
            step_m: (R, W, 2) steps.
            weights: (R, W) of all layers at the points.
        """
        result: Any = None
        below: Any = None
        for index, (lookup, weight) in enumerate(zip(lookups, weights, strict=True)):
            if lookup is None:
                continue
            texel = self._tiled(self._material.layers[index].maps, level, lookup, step_m)
            key = keys(texel[..., 3], weight)
            if result is None:
                result, below = texel, key
                continue
            factor, below = mix(key, below, self._borders[level][index - 1])
            result = result + (texel - result) * factor[..., None]
        return np.asarray(result[..., :3], np.float32)

    def _borders_at(self, level: int) -> list[LayerBorder]:
        seen = [
            self._maps_at_level(each.maps, each.maps.tile_m, level)
            for each in self._material.layers
        ]
        return borders([self._images.heights(maps).variance for maps in seen])

    def _tiled(self, maps: PbrMaps, level: int, lookups: PixelLookups, step_m: FloatArray) -> Image:
        """Return the (R, W, 4) colour and heights of a texture, as it is laid."""
        texels = self._texels_of(self._maps_at_level(maps, maps.tile_m, level))
        places = lookups.beside(step_m / maps.tile_m)
        found = [cv2.LUT(_texture(texels.image, each), LINEAR) for each in places]
        if len(found) == 1:
            return np.asarray(found[0])
        texel = mean_of_lookups(found, lookups.weights)
        restore_contrast(texel, contrast_gain(lookups.weights), texels.mean)
        return texel

    def _texels_of(self, seen: PbrMaps) -> _Texels:
        if id(seen) not in self._texels:
            heights = self._images.heights(seen).texels
            mean = np.array(mean_color(seen), np.float32)
            self._texels[id(seen)] = _Texels(np.dstack((seen.color_srgb, heights)), mean)
        return self._texels[id(seen)]

    def _variation(self, level: int, xy_m: FloatArray) -> Image:
        """Return the (R, W, 3) factor by which the ground's colour varies slowly."""
        maps, variation = self._material.layers[0].maps, self._material.variation
        size_m = variation.scale_m or maps.tile_m * VARIATION_TILES
        cos, sin = np.cos(VARIATION_TURN_RAD), np.sin(VARIATION_TURN_RAD)
        height = self._maps_at_level(maps, size_m, level).height
        pattern = _texture(height, xy_m @ np.array([[cos, sin], [-sin, cos]]) / size_m)
        ranges = np.array([1, 1, 1]) * variation.brightness + np.array([1, 0, -1]) * variation.tint
        factor = pattern[..., None] * ranges.astype(np.float32)
        return np.asarray(factor + (1 - ranges / 2).astype(np.float32), np.float32)

    def _maps_at_level(self, maps: PbrMaps, tile_m: float, level: int) -> PbrMaps:
        """Return the maps of a texture at a level of the material, if a tile is so wide."""
        levels = self._levels[id(maps)]
        footprint_m = float(self._footprints_m[level])
        return levels[level_at(replace(maps, tile_m=tile_m), len(levels), footprint_m)]


def _is_smooth(distance_m: FloatArray) -> NDArray[np.bool_]:
    """Return whether pixels and those around them have similar distances, none of which is 0."""
    distance = distance_m.astype(np.float32)
    square = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(distance, square), cv2.dilate(distance, square)
    return np.asarray(farthest < np.float32(MAX_STEP) * nearest)


def _upward(points_m: FloatArray) -> FloatArray:
    """Return the (H, W) size of the vertical component of the surface's normals."""
    normal = np.cross(np.gradient(points_m, axis=0), np.gradient(points_m, axis=1))
    length = np.linalg.norm(normal, axis=-1)
    return np.asarray(np.abs(normal[..., 2]) / np.maximum(length, 1e-12))


def _texture(image: NDArray[Any], uv_tiles: FloatArray) -> NDArray[Any]:
    """Return a square texture at (R, W, 2) coordinates; row 0 of the image is the top of a tile."""
    size = len(image)
    within = uv_tiles - np.floor(uv_tiles)
    x, y = within[..., 0] * size - 0.5, (1 - within[..., 1]) * size - 0.5
    return bilinear(image, x, y, cv2.BORDER_WRAP)
