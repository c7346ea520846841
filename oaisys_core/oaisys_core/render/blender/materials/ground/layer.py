"""One layer of the ground as a surface: its texture, tiling, slope and gloss."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from oaisys_core.procedural.terrain.macro_variation import MAX_FACTOR, MIN_FACTOR
from oaisys_core.procedural.textures.levels import level_at
from oaisys_core.procedural.textures.normal_maps import FLAT, STEPS
from oaisys_core.render.blender.materials.images import ImageStore
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.render.blender.materials.photometric import by_law
from oaisys_core.render.blender.materials.surfaces import add_gloss, diffuse
from oaisys_core.render.blender.materials.tiling import TextureLookup, TilingNodes
from oaisys_core.render.shading.looks import (
    ALONG_BEDS,
    BED_BRIGHTNESS_POWER,
    BED_SCALE,
    BELOW_SURFACE,
    BRIGHTNESS_CHANNEL,
    MAX_TURNED_LAYERS,
    VARIATION_TILES,
    VARIATION_TURN_RAD,
    cliff_tiling,
)
from oaisys_core.render.shading.shading import mean_color
from oaisys_core.scene.surroundings import MacroVariation
from oaisys_core.scene.terrain_material import (
    MAX_TONE,
    MIN_TONE,
    PbrMaps,
    TerrainLayer,
    TerrainMaterial,
    Variation,
)
from oaisys_core.scene.tiling import PlainTiling, Tiling

NUDGE = 1e-12
"""Times something that only one part of the material has, added to coordinates: far less than their
rounding. Cycles merges nodes that are the same, such as those of two levels, and would evaluate
them for every pixel of the ground and keep the results on its stack, which holds 255 numbers."""


class Plane(NamedTuple):
    """A plane that textures are projected onto.

    Attributes:
        place: Coordinates in the plane, in metres.
        axes: The axes of ``map`` that are its u and v; None: x and y.
    """

    place: Socket
    axes: tuple[int, int] | None


class MaterialTables(NamedTuple):
    """What all levels of a ground's materials share.

    Attributes:
        macro: Image of `MacroVariation.share`; None if the colour does not vary so.
        tone: Image of `TerrainMaterial.tone`; None if there is none.
        tilings: Images of tiling tables, see `TilingNodes`.
        glossy: By identity of texture sets, whether they have glossy parts.
        varies: Whether the ground's colour varies beyond its textures.
    """

    macro: Any
    tone: Any
    tilings: dict[int, Any]
    glossy: dict[int, bool]
    varies: bool


class MaterialLevel(NamedTuple):
    """A terrain material at one level of detail.

    Attributes:
        material: The material.
        images: Images of its texture sets.
        tables: What its levels share.
        finer: Number of finer levels.
        footprint_m: Size of a pixel on the ground.
    """

    material: TerrainMaterial
    images: ImageStore
    tables: MaterialTables
    finer: int
    footprint_m: float

    def level_of(self, maps: PbrMaps, tile_m: float) -> PbrMaps:
        """Return the level of a texture set for this footprint, if a tile is ``tile_m`` wide."""
        levels = self.images.levels(maps)
        return levels[level_at(replace(maps, tile_m=tile_m), len(levels), self.footprint_m)]

    def number(self, axes: tuple[int, int] | None, part: int) -> int:
        """Return a number that no other level, plane or part has; a level has 2 + layers parts."""
        plane = 0 if axes is None else 1 + axes[0]
        return (3 * self.finer + plane) * (2 + len(self.material.layers)) + part + 1

    def nudge(self, axes: tuple[int, int] | None, part: int) -> tuple[float, float, float]:
        """Return a vector that no other level, plane or part has, see `NUDGE`."""
        return (NUDGE * self.number(axes, part), 0.0, 0.0)


class LayerNodes:
    """Adds nodes for the layers of one level, projected onto one plane.

    What it adds for one layer keeps no number on Cycles' stack for another, see `NUDGE`.
    """

    def __init__(self, tree: NodeTree, level: MaterialLevel, axes: tuple[int, int] | None) -> None:
        self._tree = tree
        self._level = level
        self._images = level.images
        self._tilings = TilingNodes(tree, level.tables.tilings)
        # The ground's vertices are in ``map``, so positions need no transform.
        geometry = tree.add("NewGeometry").outputs
        self._position, self._normal = geometry["Position"], geometry["Normal"]
        place = self._position
        if axes is not None:
            parts = tree.add("SeparateXYZ", {0: self._position}).outputs
            place = tree.combine(parts[axes[0]], parts[axes[1]], 0.0)
        self._plane = Plane(place, axes)
        self._nudge = level.nudge(axes, 0)

    def color_and_height(self, index: int, nudge: Socket) -> tuple[Socket, Socket]:
        """Return the colour of a layer's texture, and its encoded height, see `borders`."""
        tree = self._tree
        maps, lookups = self._lookups(index, nudge)
        image = self._images.color(maps)
        texels = [
            tree.add("TexImage", {"Vector": lookup.place}, image=image).outputs
            for lookup in lookups
        ]
        red, green, blue = mean_color(maps)
        weights = [lookup.weight for lookup in lookups]
        color = _mixture(tree, [each["Color"] for each in texels], weights, (red, green, blue))
        if len(texels) > 1:
            color = tree.vector("MAXIMUM", color, (0.0, 0.0, 0.0))
        return color, _mean(tree, [each["Alpha"] for each in texels], weights)

    def with_variation(self, color: Socket) -> Socket:
        """Return a colour of layers times what varies slowly over all of them."""
        tree, material = self._tree, self._level.material
        variation = self._variation(material.layers[0].maps, material.variation)
        if variation is not None:
            color = tree.vector("MULTIPLY", color, variation)
        if self._level.tables.tone is not None:
            color = tree.vector("MULTIPLY", color, self._tone(self._level.tables.tone))
        if material.macro is not None:
            color = tree.vector("MULTIPLY", color, self._macro(material.macro))
        return color

    def surface(self, index: int, color: Socket) -> Socket:
        """Return the surface of a layer of a colour."""
        tree, maps = self._tree, self._level.material.layers[index].maps
        detail, roughness = self._detail_and_roughness(index)
        if self._level.material.is_lambertian:
            roughness = 0.0
        # Diffuse shaders normalise it.
        normal = tree.vector("ADD", self._normal, self._slope(detail, self._plane))
        if self._level.material.law is not None:
            color = by_law(tree, color, normal)
        surface, _ = diffuse(tree, color, roughness, normal)
        if maps.subsurface:
            below = tree.vector("MULTIPLY", color, BELOW_SURFACE)
            inside, _ = diffuse(tree, below, roughness, self._normal)
            surface = tree.mix(maps.subsurface, surface, inside)
        if self._level.tables.glossy[id(maps)]:
            unit = tree.vector("NORMALIZE", normal)
            surface = add_gloss(tree, surface, roughness, unit)
        return surface

    def _slope(self, detail: Socket, plane: Plane) -> Socket:
        """Return the slope that an encoded normal of a plane stands for, in ``map``."""
        tree = self._tree
        gain, start = 255 / STEPS, -FLAT / STEPS
        slope = tree.vector("MULTIPLY_ADD", detail, (gain, gain, 0.0), (start, start, 0.0))
        if plane.axes is None:
            return slope
        parts: list[Socket] = [0.0, 0.0, 0.0]
        for component, axis in enumerate(plane.axes):
            parts[axis] = tree.component(slope, component)
        return tree.combine(*parts)

    def _tiling(self, layer: TerrainLayer) -> Tiling:
        """Return how a layer's texture is laid onto this plane."""
        is_free = isinstance(layer.tiling, PlainTiling) and layer.label_image is None
        is_few = len(self._level.material.layers) <= MAX_TURNED_LAYERS
        if self._plane.axes is None or not is_free or not is_few:
            return layer.tiling
        return cliff_tiling()

    def _lookups(self, index: int, nudge: Socket) -> tuple[PbrMaps, list[TextureLookup]]:
        """Return the texture set that is seen of a layer, and where, moved by a nudge."""
        layer, plane = self._level.material.layers[index], self._plane
        maps = self._level.level_of(layer.maps, layer.maps.tile_m)
        if layer.label_image is not None and plane.axes is not None:
            # Labels of such a layer are projected from above, so its colours must be, too.
            plane = Plane(self._position, plane.axes)
        scale = (1.0 / maps.tile_m,) * 3
        place = self._tree.vector("MULTIPLY_ADD", plane.place, scale, nudge)
        return maps, self._tilings.lookups(self._tiling(layer), place)

    def _detail_and_roughness(self, index: int) -> tuple[Socket, Socket]:
        """Return the encoded normal of a layer's texture, and its roughness."""
        maps, lookups = self._lookups(index, self._level.nudge(self._plane.axes, 2 + index))
        image = self._images.normal_roughness(maps)
        texels = [self._detail(image, lookup) for lookup in lookups]
        weights = [lookup.weight for lookup in lookups]
        # The mean; NumPy takes many times as long along an axis of three.
        sums, texels_count = cv2.sumElems(maps.normal_gl)[:3], maps.normal_gl[..., 0].size
        x, y, z = (total / texels_count / 255 for total in sums)
        detail = _mixture(self._tree, [each[0] for each in texels], weights, (x, y, z))
        return detail, _mean(self._tree, [each[1] for each in texels], weights)

    def _detail(self, image: Any, lookup: TextureLookup) -> tuple[Socket, Socket]:
        tree = self._tree
        texel = tree.add("TexImage", {"Vector": lookup.place}, image=image).outputs
        detail = texel["Color"]
        if lookup.angle is not None:
            # Rotating the coordinates rotates the texture's slopes the other way.
            inputs: dict[str | int, Any] = {
                "Vector": detail,
                "Center": (FLAT / 255, FLAT / 255, 0.0),
                "Angle": tree.math("MULTIPLY", lookup.angle, -1.0),
            }
            detail = tree.add("VectorRotate", inputs, rotation_type="Z_AXIS").outputs[0]
        return detail, texel["Alpha"]

    def _variation(self, maps: PbrMaps, variation: Variation) -> Socket | None:
        """Return a slowly varying colour factor around 1, which hides that textures repeat."""
        if not self._level.tables.varies:
            return None
        tree = self._tree
        size_m = variation.scale_m or maps.tile_m * VARIATION_TILES
        image = self._images.height(self._level.level_of(maps, size_m))
        texel = tree.add("TexImage", {"Vector": self._plane.place}, image=image)
        # The node's own mapping is a matrix; a separate node would evaluate sine and cosine.
        texel.texture_mapping.rotation[2] = VARIATION_TURN_RAD
        texel.texture_mapping.scale = (1.0 / size_m,) * 3
        texel.texture_mapping.translation = self._nudge
        ranges = np.array([1, 1, 1]) * variation.brightness + np.array([1, 0, -1]) * variation.tint
        least = tuple((1 - ranges / 2).tolist())
        return tree.vector("MULTIPLY_ADD", texel.outputs["Color"], tuple(ranges.tolist()), least)

    def _tone(self, image: Any) -> Socket:
        """Return the colour factor of the ground's tone; its edge goes on beyond the stage."""
        tree = self._tree
        x0, y0, x1, y1 = self._level.material.extent_m
        texel = tree.add("TexImage", {"Vector": self._position}, image=image, extension="EXTEND")
        mapping = texel.texture_mapping
        mapping.scale = (1 / (x1 - x0), 1 / (y1 - y0), 1.0)
        moved = np.array(self._nudge) - (x0 / (x1 - x0), y0 / (y1 - y0), 0.0)
        mapping.translation = moved.tolist()
        span = MAX_TONE - MIN_TONE
        return tree.vector("MULTIPLY_ADD", texel.outputs["Color"], span, MIN_TONE)

    def _macro(self, macro: MacroVariation) -> Socket:
        """Return the colour factor that varies from metres to kilometres; cliffs have beds, too."""
        tree = self._tree
        factor = self._pattern(self._plane.place, (1.0, 1.0), macro)
        if self._plane.axes is None:
            return factor
        # The same along both sides, so that beds go on around the corners of a cliff.
        along = tree.dot(self._position, ALONG_BEDS)
        height = tree.component(self._position, 2)
        beds = self._pattern(tree.combine(along, height, 0.0), BED_SCALE, macro)
        brightness = tree.component(beds, BRIGHTNESS_CHANNEL)
        power = tree.math("POWER", brightness, BED_BRIGHTNESS_POWER)
        return tree.vector("MULTIPLY", factor, tree.scale(beds, power))

    def _pattern(self, place: Socket, scale: tuple[float, float], macro: MacroVariation) -> Socket:
        """Return the factor at a place, of a pattern that is larger by ``scale`` in u and v."""
        texel = self._tree.add("TexImage", {"Vector": place}, image=self._level.tables.macro)
        u, v = (1.0 / (macro.period_m * each) for each in scale)
        texel.texture_mapping.scale = (u, v, 1.0)
        texel.texture_mapping.translation = self._nudge
        span = MAX_FACTOR - MIN_FACTOR
        return self._tree.vector("MULTIPLY_ADD", texel.outputs["Color"], span, MIN_FACTOR)


def _mean(tree: NodeTree, parts: list[Socket], weights: list[Socket]) -> Socket:
    """Return the weighted sum of numbers."""
    if len(parts) == 1:
        return parts[0]
    total: Socket = 0.0
    for part, weight in zip(parts, weights, strict=True):
        total = tree.math("MULTIPLY_ADD", part, weight, total)
    return total


def _mixture(
    tree: NodeTree, parts: list[Socket], weights: list[Socket], mean: tuple[float, float, float]
) -> Socket:
    """Return ``mean`` plus a multiple of the weighted sum's deviation from it.

    The factor restores the variance of a single part (Heitz and Neyret).
    """
    if len(parts) == 1:
        return parts[0]
    squares: Socket = 0.0
    for weight in weights:
        squares = tree.math("MULTIPLY_ADD", weight, weight, squares)
    gain = tree.math("INVERSE_SQRT", squares)
    total: Socket = tuple(-value for value in mean)
    for part, weight in zip(parts, weights, strict=True):
        total = tree.vector("MULTIPLY_ADD", part, weight, total)
    return tree.vector("MULTIPLY_ADD", total, gain, mean)
