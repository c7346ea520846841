"""The ground's look at any point: its layers, mixed by their masks and relief, as Cycles has them.

What Cycles' shader nodes do for each sample is done here for arrays of points; see
`oaisys_core.render.blender.materials.ground`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.contact_map import ContactMap
from oaisys_core.procedural.terrain.macro_variation import MAX_FACTOR, MIN_FACTOR
from oaisys_core.procedural.textures.borders import (
    NEGLIGIBLE,
    LayerBorder,
    borders,
    keys,
    mix,
)
from oaisys_core.procedural.textures.levels import level_at
from oaisys_core.render.draft.appearance import Appearance, Floats, normalise
from oaisys_core.render.draft.ground.ground_details import add_contact, darken_wet
from oaisys_core.render.draft.ground.ground_masks import GroundMasks
from oaisys_core.render.draft.ground.layer_texture import LayerLook, LayerTexture, Levels
from oaisys_core.render.draft.ground.texture_atlas import TextureAtlas, sample
from oaisys_core.render.shading.looks import (
    ALONG_BEDS,
    BED_CONTRAST,
    BED_SCALE,
    MAX_TURNED_LAYERS,
    SIDE_BLEND,
    STEEP_COS,
    VARIATION_TILES,
    VARIATION_TURN_RAD,
    cliff_tiling,
    footprints_m,
    varies,
)
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene.terrain_material import PbrMaps, TerrainMaterial
from oaisys_core.scene.tiling import PlainTiling, Tiling
from oaisys_core.types import FloatArray

Axes = tuple[int, int] | None
"""The axes of ``map`` that are u and v of the plane that textures are projected onto; None: x, y,
seen from above."""

LOWEST = -18.0
"""Key below any layer's, see `borders`."""

MOST = 0.6
"""Share of the points from which on a layer is looked up at all of them."""


class GroundTexture:
    """Looks up how the ground looks.

    Attributes:
        contact: Where fines lie on the ground; None: nowhere.
        driven: How much of its way each rover has driven, for the tracks in ``contact``.
    """

    contact: ContactMap | None = None
    driven: tuple[float, ...] = ()

    def __init__(self, material: TerrainMaterial, store: LevelStore) -> None:
        """Take over a material."""
        self._material = material
        self._bounds_m = np.array(footprints_m(material))
        self._layers = [LayerTexture(each, store, self._bounds_m) for each in material.layers]
        self._masks = GroundMasks(material)
        self._borders = self._borders_by_level()
        self._variation: TextureAtlas | None = None
        if varies(material):
            self._variation = self._pattern_of(material.layers[0].maps, store)
        self._macro: NDArray[np.uint8] | None = None
        if material.macro is not None:
            self._macro = np.pad(material.macro.share, ((1, 1), (1, 1), (0, 0)), mode="wrap")

    @property
    def mean_albedo(self) -> Floats:
        """(3,) mean albedo of the ground on the stage."""
        shares = self._material.masks.mean(axis=(1, 2))
        means = np.array([layer.mean for layer in self._layers])
        return np.asarray(shares @ means / shares.sum(), np.float32)

    def at(self, points_m: FloatArray, normals: Floats, footprint_m: Floats) -> Appearance:
        """Return how (N, 3) points look.

        Args:
            points_m: In ``map``.
            normals: (N, 3) unit normals of the surface without its texture.
            footprint_m: (N,) sizes of a pixel there, see `pixel_angle_rad`.
        """
        level = np.searchsorted(self._bounds_m[1:], footprint_m)
        xy_m = points_m[:, :2]
        weights = self._masks.weights(xy_m)
        above = self._project(points_m, None, weights, level)
        color, roughness = above.color, above.roughness
        lean = np.zeros_like(normals)
        lean[:, :2] = above.slope
        if self._material.projects_sides:
            self._add_sides(points_m, normals, weights, level, (color, lean, roughness))
        if self.contact is not None:
            means = np.array([layer.mean for layer in self._layers])
            is_image = any(layer.has_labels for layer in self._layers)
            fines = None if is_image else weights @ means
            add_contact(self.contact, self.driven, xy_m, fines, (color, lean, roughness))
        if self._material.wet_bank_m is not None:
            darken_wet(self._material.wet_bank_m, points_m[:, 2], color)
        if self._material.is_lambertian:
            roughness[:] = 0
        through = np.zeros(len(points_m), np.float32)
        return Appearance(color, normalise(normals + lean), normals, roughness, through)

    def _add_sides(
        self,
        points_m: FloatArray,
        normals: Floats,
        weights: Floats,
        level: Levels,
        found: tuple[Floats, Floats, Floats],
    ) -> None:
        """Replace, in place, colour, lean and roughness where it is steep."""
        up = np.abs(normals[:, 2])
        steep = np.flatnonzero(up < STEEP_COS[0])
        if not len(steep):
            return
        share = np.clip((STEEP_COS[0] - up[steep]) / (STEEP_COS[0] - STEEP_COS[1]), 0, 1)
        nx, ny = np.abs(normals[steep, 0]), np.abs(normals[steep, 1])
        turn = np.clip((nx - ny) * np.float32(SIDE_BLEND) + np.float32(0.5), 0, 1)
        color, lean, roughness = found
        sides: tuple[tuple[tuple[int, int], Floats], ...] = (((0, 2), 1 - turn), ((1, 2), turn))
        of_sides = [np.zeros((len(steep), 3), np.float32) for _ in range(2)]
        rough = np.zeros(len(steep), np.float32)
        for axes, side_share in sides:
            rows = np.flatnonzero(side_share > 0)
            if not len(rows):
                continue
            seen = steep[rows]
            plane = self._project(points_m[seen], axes, weights[seen], level[seen])
            part = side_share[rows, None]
            of_sides[0][rows] += part * plane.color
            for component, axis in enumerate(axes):
                of_sides[1][rows, axis] += part[:, 0] * plane.slope[:, component]
            rough[rows] += part[:, 0] * plane.roughness
        part = share[:, None].astype(np.float32)
        color[steep] += part * (of_sides[0] - color[steep])
        lean[steep] += part * (of_sides[1] - lean[steep])
        roughness[steep] += part[:, 0] * (rough - roughness[steep])

    def _project(
        self, points_m: FloatArray, axes: Axes, weights: Floats, level: Levels
    ) -> LayerLook:
        """Return what (N, 3) points look like, projected onto a plane."""
        place_m = points_m[:, :2] if axes is None else points_m[:, list(axes)]
        count = len(points_m)
        found = LayerLook(
            np.zeros((count, 3), np.float32),
            np.zeros((count, 2), np.float32),
            np.zeros(count, np.float32),
        )
        # As below a layer of no weight.
        below = np.full(count, LOWEST, np.float32)
        for index, layer in enumerate(self._layers):
            weight = weights[:, index]
            is_seen = weight > NEGLIGIBLE
            seen = int(np.count_nonzero(is_seen))
            if not seen:
                continue
            rows: NDArray[np.intp] | slice = slice(None)
            if seen < MOST * count:
                rows = np.flatnonzero(is_seen)
            at_m = points_m[:, :2] if layer.has_labels else place_m
            tiling = self._tiling(layer, axes)
            texel, height = layer.look_up(at_m[rows], level[rows], tiling)
            key = keys(height, weight[rows])
            if index == 0:
                factor: Floats = np.ones(len(key), np.float32)
                below[rows] = key
            else:
                found_of = (np.asarray(each)[level[rows]] for each in self._borders[index - 1])
                border = LayerBorder(*found_of)
                factor, below[rows] = mix(key, below[rows], border)
            for old, new in zip(found, texel, strict=True):
                part = factor if old.ndim == 1 else factor[:, None]
                old[rows] += part * (new - old[rows])
        self._vary(place_m, points_m, axes, level, found.color)
        return found

    def _tiling(self, layer: LayerTexture, axes: Axes) -> Tiling:
        """Return how a layer's texture is laid onto a plane."""
        is_free = isinstance(layer.tiling, PlainTiling) and not layer.has_labels
        is_few = len(self._layers) <= MAX_TURNED_LAYERS
        return cliff_tiling() if axes is not None and is_free and is_few else layer.tiling

    def _vary(
        self, place_m: FloatArray, points_m: FloatArray, axes: Axes, level: Levels, color: Floats
    ) -> None:
        """Multiply colours, in place, by what varies slowly over all layers."""
        if self._variation is not None:
            variation, maps = self._material.variation, self._layers[0].maps
            size_m = variation.scale_m or maps.tile_m * VARIATION_TILES
            cos, sin = np.cos(VARIATION_TURN_RAD), np.sin(VARIATION_TURN_RAD)
            turned = place_m @ np.array([[cos, sin], [-sin, cos]]) / size_m
            places = self._variation.places(turned, self._variation_level[level])
            ranges = np.array([1, 1, 1]) * variation.brightness
            ranges = ranges + np.array([1, 0, -1]) * variation.tint
            pattern = self._variation.look_up(places)[:, None]
            color *= pattern * ranges.astype(np.float32) + (1 - ranges / 2).astype(np.float32)
        if self._macro is not None:
            color *= self._macro_factor(place_m, (1.0, 1.0), 1.0)
            if axes is not None:
                along = points_m @ np.array(ALONG_BEDS)
                beds = np.column_stack((along, points_m[:, 2]))
                color *= self._macro_factor(beds, BED_SCALE, BED_CONTRAST)

    def _macro_factor(
        self, place_m: FloatArray, scale: tuple[float, float], contrast: float
    ) -> Floats:
        macro, image = self._material.macro, self._macro
        assert macro is not None
        assert image is not None
        size = len(image) - 2
        at = place_m / (np.array(scale) * macro.period_m)
        within = ((at - np.floor(at)) * size + 0.5).astype(np.float32)
        share = sample(image, within[:, 0], within[:, 1])
        span = np.float32(contrast * (MAX_FACTOR - MIN_FACTOR) / 255)
        return np.asarray(share * span + np.float32(1 - contrast * (1 - MIN_FACTOR)))

    def _pattern_of(self, maps: PbrMaps, store: LevelStore) -> TextureAtlas:
        """Return the heights of a texture set, by which the ground's colour varies."""
        levels = store.levels(maps)
        size_m = self._material.variation.scale_m or maps.tile_m * VARIATION_TILES
        wide = replace(maps, tile_m=size_m)
        self._variation_level = np.array(
            [level_at(wide, len(levels), each) for each in self._bounds_m.tolist()]
        )
        return TextureAtlas([each.height for each in levels])

    def _borders_by_level(self) -> list[LayerBorder]:
        """Return the border of each layer but the first, as arrays over the ground's levels."""
        variances = [np.array(layer.variances) for layer in self._layers]
        return [
            LayerBorder(*(np.broadcast_to(each, self._bounds_m.shape) for each in border))
            for border in borders(variances)
        ]
