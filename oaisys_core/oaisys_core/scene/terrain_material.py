"""The material of the ground: texture sets, layers made of them, and where each layer lies.

All coordinates are in ``map`` (metres, z up).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.color import LUMINANCE, mean_linear
from oaisys_core.scene.heaviest_layers import UNCERTAIN, HeaviestLayers
from oaisys_core.scene.photometric_laws import PhotometricLaw
from oaisys_core.scene.surroundings import LandMasks, MacroVariation
from oaisys_core.scene.tiling import PlainTiling, Tiling
from oaisys_core.types import FloatArray

STEEP_COS = (0.77, 0.57)
"""Vertical component of the normal (40 and 55 degrees of slope) between which the texture projected
from above gives way to those from the sides."""

MIN_TONE, MAX_TONE = 0.3, 1.7
"""Bounds of the factors of a ground's tone."""

SAMPLED_PX = 256
"""Pixels of a texture's row of which its mean colour is taken."""

BLOCK = 16384
"""Points that are labelled at once, so that intermediate arrays fit into the CPU cache."""


@dataclass(frozen=True)
class PbrMaps:
    """One tileable texture set, all maps square and of one size.

    Attributes:
        name: Name in messages and cache keys.
        color_srgb: (N, N, 3) uint8, sRGB-encoded albedo; row 0 is the top of the image.
        height: (N, N) float32, 0 to 1.
        normal_gl: (N, N, 3) uint8, tangent-space normals in OpenGL's convention (green up), see
            `oaisys_core.procedural.textures.normal_maps`.
        roughness: (N, N) uint8, linear.
        tile_m: Edge length of one tile in metres.
        subsurface: Share of the light that comes out again some centimetres from where it went
            in, and does not see the texture's relief, as in snow and ice.
    """

    name: str
    color_srgb: NDArray[np.uint8]
    height: NDArray[np.float32]
    normal_gl: NDArray[np.uint8]
    roughness: NDArray[np.uint8]
    tile_m: float
    subsurface: float = 0.0

    def mean_of_texels(self) -> FloatArray:
        """Return the (3,) mean linear colour of evenly spaced texels."""
        step = max(len(self.color_srgb) // SAMPLED_PX, 1)
        return mean_linear(self.color_srgb[::step, ::step])


@dataclass(frozen=True)
class LabelImage:
    """Labels that vary within a texture tile.

    Attributes:
        semantic_ids: (levels, rows, columns) uint16; row 0 is the top of the image.
    """

    semantic_ids: NDArray[np.uint16]

    def ids_at(self, uv_tiles: FloatArray, level: int) -> NDArray[np.uint16]:
        """Return the (N,) ids of the pixels nearest to (N, 2) texture coordinates, v upwards."""
        levels, rows, columns = self.semantic_ids.shape
        if level >= levels:
            return np.zeros(len(uv_tiles), np.uint16)
        u, v = (uv_tiles - np.floor(uv_tiles)).T
        column = np.minimum((u * columns).astype(np.intp), columns - 1)
        row = rows - 1 - np.minimum((v * rows).astype(np.intp), rows - 1)
        return np.asarray(self.semantic_ids[level, row, column])


@dataclass(frozen=True)
class TerrainLayer:
    """A texture set on the ground, with its labels by level.

    Attributes:
        tiling: How copies of the texture are laid on the ground.
        label_image: Labels that vary within a tile; None if they are ``semantic_ids`` everywhere.
        sward: The grass that stands on it, by name; None for none.
        loose_stones: The stones that lie on it, by name; None for none.
        rock_faces: Whether its walls are of broken rock.
    """

    label: str
    semantic_ids: tuple[int, ...]
    maps: PbrMaps
    tiling: Tiling = field(default_factory=PlainTiling)
    label_image: LabelImage | None = None
    sward: str | None = None
    loose_stones: str | None = None
    rock_faces: bool = False

    def ids_at(self, xy_m: FloatArray, level: int) -> NDArray[np.uint16]:
        """Return (N,) ids of the layer at (N, 2) points, by the texture sample of most weight."""
        if self.label_image is None:
            return np.full(len(xy_m), id_of_level(self.semantic_ids, level), np.uint16)
        samples = self.tiling.samples(xy_m / self.maps.tile_m)
        heaviest = samples.weights.argmax(axis=0)
        return self.label_image.ids_at(samples.uv_tiles[heaviest, np.arange(len(xy_m))], level)

    @property
    def all_semantic_ids(self) -> frozenset[int]:
        """All ids that the layer has on any level."""
        image = self.label_image
        more = () if image is None else np.unique(image.semantic_ids).tolist()
        return frozenset((*self.semantic_ids, *more))


@dataclass(frozen=True)
class Variation:
    """Change of the ground's colour in a pattern that repeats: the first layer's height map.

    Attributes:
        brightness: Range of the brightness factor around 1.
        tint: Range of the factor on red around 1; blue changes in the opposite direction.
        scale_m: Edge length of the pattern's tile; None derives it from the tiles of the layers.
    """

    brightness: float = 0.35
    tint: float = 0.0
    scale_m: float | None = None


class Tone(Protocol):
    """Slow change of the stage's colour: a frozen dataclass, whose fields say what it is.

    Many views show no colour, so that its image is made when it is first asked for.
    """

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """(T, T, 3) uint8 factors on the linear colour, from `MIN_TONE` to `MAX_TONE`."""


@dataclass(frozen=True)
class TerrainMaterial:
    """Layers of the ground, blended with one weight mask per layer.

    Attributes:
        layers: At least one.
        masks: (L, M, M) float32 weights at the cell centres of an M x M grid over the extent; row
            0 at min_y, column 0 at min_x. The weights of all layers sum to 1.
        extent_m: (min_x, min_y, max_x, max_y) that the masks cover.
        label_cell_m: Cell size of soft label borders; None for hard borders.
        variation: Slow change of colour over the ground.
        projects_sides: Whether textures are projected onto steep slopes from the side instead of
            from above.
        tone: Change of the colour over the extent, row 0 at min_y; that of its edge goes on beyond
            it. None for none.
        macro: Variation of colour from metres to kilometres; None for none.
        land: Weights of the layers on the land around the extent; None if there is no land.
        wet_bank_m: Heights up to which the ground is wet and from which it is dry; None without
            water.
        wet_extent_m: (min_x, min_y, max_x, max_y) beyond which it is dry; None: the stage's.
        is_lambertian: Whether the ground reflects by Lambert's law, whatever its roughness.
        law: By which the ground reflects relative to Lambert's law; None for as it. Only with
            ``is_lambertian``.
    """

    layers: tuple[TerrainLayer, ...]
    masks: NDArray[np.float32]
    extent_m: tuple[float, float, float, float]
    label_cell_m: float | None = None
    variation: Variation = Variation()
    projects_sides: bool = False
    tone: Tone | None = None
    macro: MacroVariation | None = None
    land: LandMasks | None = None
    wet_bank_m: tuple[float, float] | None = None
    wet_extent_m: tuple[float, float, float, float] | None = None
    is_lambertian: bool = False
    law: PhotometricLaw | None = None

    def weights_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N, L) bilinearly interpolated weights at (N, 2) points.

        Outside the extent the masks are mirrored, as in the rendered image, or lead over to those
        of the land.
        """
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        x0, y0, x1, y1 = self.extent_m
        size = self.masks.shape[1]
        column, s = _texels(xy[:, 0], x0, x1, size)
        row, t = _texels(xy[:, 1], y0, y1, size)
        index = row * size + column
        m00, m10, m01, m11 = (
            self._flat_masks.take(index + step, axis=1, mode="clip")
            for step in (0, 1, size, size + 1)
        )
        lower, upper = m00 * (1 - s) + m10 * s, m01 * (1 - s) + m11 * s
        weights = np.asarray(lower * (1 - t) + upper * t).T
        return weights if self.land is None else self.land.blend(xy, weights)

    def of_layer(self, layer: int) -> TerrainMaterial:
        """Return a material that has one of the layers everywhere, and is as this one otherwise."""
        masks = np.ones((1, 2, 2), np.float32)
        return replace(self, layers=(self.layers[layer],), masks=masks, land=None)

    @cached_property
    def mean_luminance(self) -> float:
        """Mean linear luminance of the layers' albedo, 0 to 1, by their shares of the stage."""
        colors = [layer.maps.mean_of_texels() for layer in self.layers]
        shares = self.masks.mean(axis=(1, 2), dtype=np.float64)
        return float(shares @ np.array(colors) @ LUMINANCE / shares.sum())

    @cached_property
    def patch_m(self) -> float:
        """Mean length of a line within one layer, the heaviest there; infinite for one layer."""
        heaviest = np.argmax(self.masks, axis=0)
        changes = sum(np.count_nonzero(np.diff(heaviest, axis=axis)) for axis in (0, 1))
        x0, y0, x1, y1 = self.extent_m
        lines_m = len(heaviest) * ((x1 - x0) + (y1 - y0))
        return lines_m / changes if changes else float("inf")

    @cached_property
    def _flat_masks(self) -> NDArray[np.float32]:
        return np.ascontiguousarray(self.masks).reshape(len(self.masks), -1)

    @cached_property
    def _heaviest_layers(self) -> HeaviestLayers:
        return HeaviestLayers(self.masks, self.extent_m)

    def labelling_layer(self, xy_m: ArrayLike) -> NDArray[np.intp]:
        """Return the (N,) indices of the layers that label (N, 2) points.

        With hard borders this is the layer with the largest weight, the first one at a tie. With
        soft borders each small cell of the ground has a random number that picks a layer, with the
        weights as probabilities.
        """
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        if len(self.layers) == 1:
            return np.zeros(len(xy), np.intp)
        if self.label_cell_m is None:
            layers = self._heaviest_layers.at(xy)
            rest = np.flatnonzero(layers == UNCERTAIN)
            if len(rest):
                layers[rest] = np.argmax(self.weights_at(xy[rest]), axis=1)
            return layers
        weights = self.weights_at(xy)
        pick = grain_numbers(xy, self.label_cell_m) * weights.sum(axis=1)
        below = np.cumsum(weights[:, :-1], axis=1) <= pick[:, None]
        return np.asarray(below.sum(axis=1), dtype=np.intp)

    def semantic_ids_at(self, xy_m: ArrayLike, level: int = 0) -> NDArray[np.uint16]:
        """Return the (N,) uint16 semantic ids of the ground at (N, 2) points."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        result = np.empty(len(xy), np.uint16)
        for first in range(0, len(xy), BLOCK):
            block = slice(first, first + BLOCK)
            result[block] = self._ids_of_block(xy[block], level)
        return result

    def _ids_of_block(self, xy: FloatArray, level: int) -> NDArray[np.uint16]:
        chosen = self.labelling_layer(xy)
        ids = np.array([id_of_level(la.semantic_ids, level) for la in self.layers], np.uint16)
        result = np.asarray(ids[chosen])
        for index, layer in enumerate(self.layers):
            if layer.label_image is not None:
                here = np.flatnonzero(chosen == index)
                result[here] = layer.ids_at(xy[here], level)
        return result


def _texels(
    x_m: FloatArray, least_m: float, most_m: float, size: int
) -> tuple[NDArray[np.intp], FloatArray]:
    """Return (N,) lower texels of coordinates along an axis, and (N,) weights of the next ones."""
    place = (x_m - least_m) / (most_m - least_m)
    outside = (place < 0) | (place > 1)
    if outside.any():
        place[outside] = 1.0 - np.abs(1.0 - np.mod(place[outside], 2.0))
    texel = np.clip(place * size - 0.5, 0, size - 1)
    low = np.minimum(texel.astype(np.intp), size - 2)
    return low, texel - low


def grain_numbers(xy_m: FloatArray, cell_m: float) -> FloatArray:
    """Return a uniformly distributed number in [0, 1) for the cell of each (N, 2) point.

    It is a hash of the cell's position in ``map``, so it is the same in every view.
    """
    column, row = np.floor(xy_m / cell_m).astype(np.int64).astype(np.uint32).T
    mixed = column * np.uint32(0x9E3779B1) ^ (row * np.uint32(0x85EBCA77) + np.uint32(0x27220A95))
    for shift, factor in ((15, 0x2C1B3C6D), (12, 0x297A2D39), (15, 1)):
        mixed = (mixed ^ (mixed >> np.uint32(shift))) * np.uint32(factor)
    return np.asarray(mixed * 2.0**-32)


def id_of_level(semantic_ids: Sequence[int], level: int) -> int:
    """Return the id of a level, or 0 if there is none."""
    return semantic_ids[level] if level < len(semantic_ids) else 0
