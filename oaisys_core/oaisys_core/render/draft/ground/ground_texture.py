"""The ground's look at any point: its layers, mixed by their masks and relief, as Cycles has them.

What Cycles' shader nodes do for each sample is done here for arrays of points; see
`oaisys_core.render.blender.materials.ground.material`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

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
from oaisys_core.render.draft.appearance import (
    Appearance,
    Floats,
    Rows,
    normalise,
    put,
    rows_where,
    take,
    zeros,
)
from oaisys_core.render.draft.ground.ground_details import FinesColor, add_contact, darken_wet
from oaisys_core.render.draft.ground.ground_masks import GroundMasks
from oaisys_core.render.draft.ground.layer_texture import LayerLook, LayerTexture
from oaisys_core.render.draft.ground.texture_atlas import (
    Levels,
    LevelTable,
    TextureAtlas,
    fraction,
    sample,
)
from oaisys_core.render.shading.looks import (
    ALONG_BEDS,
    BED_BRIGHTNESS_POWER,
    BED_SCALE,
    BRIGHTNESS_CHANNEL,
    MAX_TURNED_LAYERS,
    SIDE_BLEND,
    VARIATION_TILES,
    VARIATION_TURN_RAD,
    cliff_tiling,
    footprints_m,
    varies,
)
from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene.terrain_material import STEEP_COS, PbrMaps, TerrainMaterial
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
        self._means = np.array([layer.mean for layer in self._layers])
        self._masks = GroundMasks(material)
        self._borders = self._borders_by_level()
        self._variation: TextureAtlas | None = None
        if varies(material):
            self._variation = self._pattern_of(material.layers[0].maps, store)
        self._macro: NDArray[np.uint8] | None = None
        if material.macro is not None:
            self._macro = np.pad(material.macro.share, ((1, 1), (1, 1), (0, 0)), mode="wrap")

    @cached_property
    def mean_albedo(self) -> Floats:
        """(3,) mean albedo of the ground on the stage."""
        shares = self._material.masks.mean(axis=(1, 2))
        return np.asarray(shares @ self._means / shares.sum(), np.float32)

    def at(self, points_m: FloatArray, normals: Floats, footprint_m: Floats) -> Appearance:
        """Return how (N, 3) points look.

        Args:
            points_m: In ``map``.
            normals: (N, 3) unit normals of the surface without its texture.
            footprint_m: (N,) sizes of a pixel there, see `pixel_angle_rad`.
        """
        level = self._levels(footprint_m)
        xy_m = points_m[:, :2]
        weights = self._masks.weights(xy_m)
        if self._material.projects_sides:
            color, lean, roughness = self._with_sides(points_m, normals, weights, level)
        else:
            color, slope, roughness = self._project(points_m, None, weights, level)
            lean = zeros(*normals.shape)
            lean[:, :2] = slope
        if self.contact is not None:
            is_image = any(layer.has_labels for layer in self._layers)
            fines = None if is_image else FinesColor(weights, self._means)
            add_contact(self.contact, self.driven, xy_m, fines, (color, lean, roughness))
        if self._material.wet_bank_m is not None:
            extent_m = self._material.wet_extent_m or self._material.extent_m
            darken_wet(self._material.wet_bank_m, extent_m, points_m, color)
        if self._material.is_lambertian:
            roughness[:] = 0
        through = np.zeros(len(points_m), np.float32)
        return Appearance(color, normalise(normals + lean), normals, roughness, through)

    def _with_sides(
        self, points_m: FloatArray, normals: Floats, weights: Floats, level: Levels
    ) -> tuple[Floats, Floats, Floats]:
        """Return colour, lean and roughness, seen from the sides where it is steep."""
        count = len(points_m)
        found = zeros(count, 3), zeros(count, 3), np.zeros(count, np.float32)
        up = np.abs(normals[:, 2])
        # Where it is steepest, nothing of the view from above is left.
        rows = rows_where(up > STEEP_COS[1])
        if isinstance(rows, slice) or len(rows):
            some = tuple(take(each, rows) for each in (points_m, weights, level))
            above = self._project(some[0], None, some[1], some[2])
            for old, new in zip((found[0], found[1][:, :2], found[2]), above, strict=True):
                put(old, rows, new)
        self._add_sides(points_m, normals, weights, level, found)
        return found

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
        span = np.float32(STEEP_COS[0] - STEEP_COS[1])
        share = np.clip((np.float32(STEEP_COS[0]) - up[steep]) / span, 0, 1)
        nx, ny = np.abs(normals[steep, 0]), np.abs(normals[steep, 1])
        turn = np.clip((nx - ny) * np.float32(SIDE_BLEND) + np.float32(0.5), 0, 1)
        sides: tuple[tuple[tuple[int, int], Floats], ...] = (((0, 2), 1 - turn), ((1, 2), turn))
        of_sides = [zeros(len(steep), 3) for _ in range(2)]
        rough = np.zeros(len(steep), np.float32)
        for axes, side_share in sides:
            rows = np.flatnonzero(side_share > 0)
            if not len(rows):
                continue
            some = tuple(take(each, steep[rows]) for each in (points_m, weights, level))
            plane = self._project(some[0], axes, some[1], some[2])
            part = side_share.take(rows)
            for channel, seen in zip(of_sides[0].T, plane.color.T, strict=True):
                channel[rows] += part * seen
            for component, axis in enumerate(axes):
                of_sides[1][rows, axis] += part * plane.slope[:, component]
            rough[rows] += part * plane.roughness
        for old, new in zip(found, (*of_sides, rough), strict=True):
            before = take(old, steep)
            part = share if old.ndim == 1 else share[:, None]
            put(old, steep, before + part * (new - before))

    def _project(
        self, points_m: FloatArray, axes: Axes, weights: Floats, level: Levels
    ) -> LayerLook:
        """Return what (N, 3) points look like, projected onto a plane."""
        place_m = points_m[:, :2] if axes is None else points_m.T[list(axes)].T
        count = len(points_m)
        found = LayerLook(zeros(count, 3), zeros(count, 2), np.zeros(count, np.float32))
        # As below a layer of no weight.
        below = np.full(count, LOWEST, np.float32)
        for index, layer in enumerate(self._layers):
            weight = weights[:, index]
            is_seen = weight > NEGLIGIBLE
            seen = int(np.count_nonzero(is_seen))
            if not seen:
                continue
            rows: Rows = slice(None) if seen >= MOST * count else np.flatnonzero(is_seen)
            at_m = points_m[:, :2] if layer.has_labels else place_m
            tiling = self._tiling(layer, axes)
            of_rows = take(level, rows)
            texel, height = layer.look_up(take(at_m, rows), of_rows, tiling)
            key = keys(height, take(weight, rows))
            if index == 0:
                below[rows] = key
                for old, new in zip(found, texel, strict=True):
                    put(old, rows, new)
                continue
            border = LayerBorder(*(each.take(of_rows) for each in self._borders[index - 1]))
            factor, below[rows] = mix(key, take(below, rows), border)
            for old, new in zip(found, texel, strict=True):
                part = factor if old.ndim == 1 else factor[:, None]
                before = take(old, rows)
                put(old, rows, before + part * (new - before))
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
            cos, sin = np.cos(VARIATION_TURN_RAD) / size_m, np.sin(VARIATION_TURN_RAD) / size_m
            x_m, y_m = place_m.T
            turned = x_m * cos - y_m * sin, x_m * sin + y_m * cos
            places = self._variation.places(turned, level)
            pattern = self._variation.look_up(places)
            for channel, tint in zip(color.T, (1, 0, -1), strict=True):
                range_ = np.float32(variation.brightness + tint * variation.tint)
                channel[:] *= pattern * range_ + (1 - range_ / 2)
        if self._material.tone is not None:
            color *= self._masks.tone(points_m[:, :2])
        if self._macro is not None:
            color *= self._macro_factor(place_m, (1.0, 1.0))
            if axes is not None:
                place_m = np.stack((points_m @ np.array(ALONG_BEDS), points_m[:, 2])).T
                beds = self._macro_factor(place_m, BED_SCALE)
                color *= beds * beds[:, [BRIGHTNESS_CHANNEL]] ** BED_BRIGHTNESS_POWER

    def _macro_factor(self, place_m: FloatArray, scale: tuple[float, float]) -> Floats:
        macro, image = self._material.macro, self._macro
        assert macro is not None
        assert image is not None
        size = len(image) - 2
        at = (each * (1 / (by * macro.period_m)) for each, by in zip(place_m.T, scale, strict=True))
        x, y = (fraction(each) * np.float32(size) + np.float32(0.5) for each in at)
        share = sample(image, x, y)
        span = np.float32((MAX_FACTOR - MIN_FACTOR) / 255)
        return np.asarray(share * span + np.float32(MIN_FACTOR))

    def _levels(self, footprint_m: Floats) -> Levels:
        """Return the (N,) levels of detail; `numpy.searchsorted` takes ten times as long."""
        level = np.zeros(len(footprint_m), np.uint8)
        for bound_m in self._bounds_m[1:].astype(np.float32):
            level += footprint_m > bound_m
        return level

    def _pattern_of(self, maps: PbrMaps, store: LevelStore) -> TextureAtlas:
        """Return the heights of a texture set, by which the ground's colour varies."""
        levels = store.levels(maps)
        size_m = self._material.variation.scale_m or maps.tile_m * VARIATION_TILES
        wide = replace(maps, tile_m=size_m)
        bounds_m = self._bounds_m.tolist()
        level_of = np.array([level_at(wide, len(levels), each) for each in bounds_m])
        return TextureAtlas([each.height for each in levels], level_of)

    def _borders_by_level(self) -> list[tuple[LevelTable, ...]]:
        """Return the `LayerBorder` of each layer but the first, by the ground's levels."""
        variances = [np.array(layer.variances) for layer in self._layers]
        return [
            tuple(LevelTable(np.broadcast_to(each, self._bounds_m.shape)) for each in border)
            for border in borders(variances)
        ]
