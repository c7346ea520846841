"""The ground's material: layers mixed by their masks, each laid on as its tiling says.

A mixture of surfaces evaluates only what shows of it, so each layer is a surface of its own: where
one layer lies alone, as it does nearly everywhere, the others cost nothing. The same goes for the
levels of the textures.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import log2
from typing import Any, NamedTuple

import numpy as np

from oaisys_core.backend.blender.compat import node_tree_of
from oaisys_core.backend.blender.materials.footprint import by_footprint
from oaisys_core.backend.blender.materials.haze import through_haze
from oaisys_core.backend.blender.materials.images import ImageStore
from oaisys_core.backend.blender.materials.masks import layer_shares, mask_images
from oaisys_core.backend.blender.materials.nodes import MIX_RESULT, NodeTree, Socket, in_group
from oaisys_core.backend.blender.materials.surfaces import (
    add_gloss,
    diffuse,
    is_glossy,
    new_material,
    show,
    without_detail,
)
from oaisys_core.backend.blender.materials.tiling import TextureLookup, TilingNodes
from oaisys_core.backend.raycast.shading import mean_color
from oaisys_core.textures.levels import LEAST_PX, level_at
from oaisys_core.world.terrain_material import PbrMaps, TerrainLayer, TerrainMaterial, Variation
from oaisys_core.world.tiling import PlainTiling, StochasticTiling, VoronoiTiling

VARIATION_TILES = 7.3
VARIATION_TURN_RAD = 0.65
"""Size, in tiles of the first layer, and direction of the pattern that the ground's colour
changes by: so that the two never repeat together."""

STEEP_COS = (0.77, 0.57)
"""Upward part of the normal (40 and 55 degrees) where sides begin to show, and where all is side.
"""

SIDE_BLEND = 2.5
"""How quickly one side gives way to the next around a corner."""


LOOKUPS = {PlainTiling: 1, VoronoiTiling: 2, StochasticTiling: 3}
MAX_LOOKUPS = 100
"""Looks of its texture that each kind of tiling mixes, and how many of them, over all layers,
sides and levels, a material may have before it makes do with every other level."""


class Plane(NamedTuple):
    """A plane that textures are projected onto.

    Attributes:
        place: Coordinates in it, in metres.
        axes: Which axes of ``map`` its u and v run along; None: x and y.
    """

    place: Socket
    axes: tuple[int, int] | None


class Texel(NamedTuple):
    """What a layer shows at a place."""

    color: Socket
    detail: Socket
    roughness: Socket


class MaterialTables(NamedTuple):
    """What all levels of a ground's material have in common.

    Attributes:
        masks: Weights of all layers but the first, see `mask_images`.
        tilings: Of `TilingNodes`.
        glossy: Whether texture sets, by identity, have parts that shine.
        varies: Whether the ground's colour changes from place to place.
    """

    masks: list[Any]
    tilings: dict[int, Any]
    glossy: dict[int, bool]
    varies: bool


class MaterialLevel(NamedTuple):
    """A terrain material as it looks in pixels of one size.

    Attributes:
        material: What it is.
        images: Of its texture sets.
        tables: Its own images.
        footprint_m: Size of a pixel on the ground.
    """

    material: TerrainMaterial
    images: ImageStore
    tables: MaterialTables
    footprint_m: float

    def seen(self, maps: PbrMaps, tile_m: float) -> PbrMaps:
        """Return the level of a texture set that is to be seen where its tile has a size."""
        levels = self.images.levels(maps)
        return levels[level_at(replace(maps, tile_m=tile_m), len(levels), self.footprint_m)]


def level_surface(tree: NodeTree, level: MaterialLevel) -> Socket:
    """Add the ground's surface at one level to a tree."""
    geometry = tree.add("NewGeometry").outputs
    position, material = geometry["Position"], level.material
    shares = layer_shares(tree, material, level.tables.masks, position)

    def laid_on(axes: tuple[int, int] | None) -> Socket:
        """Return the surface of all layers on a plane."""
        first, *others = (
            in_group(
                tree, "ground_layer", partial(_layer_surface, level=level, axes=axes, layer=layer)
            )
            for layer in material.layers
        )
        for surface, share in zip(others, shares, strict=True):
            first = tree.mixed(share, first, surface)
        return first

    if not material.projects_sides:
        return laid_on(None)
    nx, ny, nz = (
        tree.math("ABSOLUTE", part)
        for part in tree.add("SeparateXYZ", {0: geometry["Normal"]}).outputs
    )
    slope = 1 / (STEEP_COS[0] - STEEP_COS[1])
    steep = tree.clamped("MULTIPLY_ADD", nz, -slope, STEEP_COS[0] * slope)
    turn = tree.clamped("MULTIPLY_ADD", tree.math("SUBTRACT", nx, ny), SIDE_BLEND, 0.5)
    # Cycles evaluates only that side of a mixture that shows: level ground costs no more.
    return tree.mixed(steep, laid_on(None), tree.mixed(turn, laid_on((0, 2)), laid_on((1, 2))))


class LayerNodes:
    """Makes the surface of one layer, as if it lay everywhere, on one plane."""

    def __init__(self, tree: NodeTree, level: MaterialLevel, axes: tuple[int, int] | None) -> None:
        self._tree = tree
        self._level = level
        self._images = level.images
        self._tilings = TilingNodes(tree, level.tables.tilings)
        # The ground lies in ``map``: no coordinates need to be transformed.
        geometry = tree.add("NewGeometry").outputs
        self._position, self._normal = geometry["Position"], geometry["Normal"]
        place = self._position
        if axes is not None:
            parts = tree.add("SeparateXYZ", {0: self._position}).outputs
            place = tree.combined(parts[axes[0]], parts[axes[1]], 0.0)
        self._plane = Plane(place, axes)

    def surface(self, layer: TerrainLayer) -> Socket:
        """Return it."""
        tree, material = self._tree, self._level.material
        seen = self._level.seen(layer.maps, layer.maps.tile_m)
        texel = self._texel(replace(layer, maps=seen), self._plane)
        color = texel.color
        variation = self._variation(material.layers[0].maps, material.variation)
        if variation is not None:
            color = tree.vector("MULTIPLY", color, variation)
        # Diffuse surfaces make its length 1.
        normal = tree.vector("ADD", self._normal, self._slope(texel.detail, self._plane))
        surface, _ = diffuse(tree, color, texel.roughness, normal)
        if self._level.tables.glossy[id(layer.maps)]:
            unit = tree.vector("NORMALIZE", normal)
            surface = add_gloss(tree, surface, texel.roughness, unit)
        return surface

    def _slope(self, detail: Socket, plane: Plane) -> Socket:
        """Return how far a coded normal of a plane leans, in ``map``."""
        tree = self._tree
        slope = tree.vector("MULTIPLY_ADD", detail, (2.0, 2.0, 0.0), (-1.0, -1.0, 0.0))
        if plane.axes is None:
            return slope
        u, v, _ = tree.add("SeparateXYZ", {0: slope}).outputs
        parts: list[Socket] = [0.0, 0.0, 0.0]
        parts[plane.axes[0]], parts[plane.axes[1]] = u, v
        return tree.combined(*parts)

    def _texel(self, layer: TerrainLayer, plane: Plane) -> Texel:
        tree, maps = self._tree, layer.maps
        if layer.label_image is not None and plane.axes is not None:
            # Its labels are a matter of what lies above, so its colours must be too.
            plane = Plane(self._position, plane.axes)
        place = tree.scaled(plane.place, 1.0 / maps.tile_m)
        lookups = self._tilings.lookups(layer.tiling, place)
        if len(lookups) == 1:
            return self._sample(maps, lookups[0])
        texels = [self._sample(maps, lookup) for lookup in lookups]
        weights = [lookup.weight for lookup in lookups]
        roughness: Socket = 0.0
        for texel, weight in zip(texels, weights, strict=True):
            roughness = tree.math("MULTIPLY_ADD", texel.roughness, weight, roughness)
        gain = _contrast(tree, weights)
        red, green, blue = mean_color(maps)
        color = _mixture(tree, [t.color for t in texels], weights, gain, (red, green, blue))
        x, y, z = maps.normal_gl.reshape(-1, 3).mean(axis=0) / 255
        detail = _mixture(tree, [t.detail for t in texels], weights, gain, (x, y, z))
        return Texel(tree.vector("MAXIMUM", color, (0.0, 0.0, 0.0)), detail, roughness)

    def _sample(self, maps: PbrMaps, lookup: TextureLookup) -> Texel:
        tree = self._tree
        color = tree.add("TexImage", {"Vector": lookup.place}, image=self._images.color(maps))
        image = self._images.normal_roughness(maps)
        other = tree.add("TexImage", {"Vector": lookup.place}, image=image)
        detail = other.outputs["Color"]
        if lookup.angle is not None:
            # The texture was turned one way under the place, so its slopes turn the other way.
            inputs: dict[str | int, Any] = {
                "Vector": detail,
                "Center": (0.5, 0.5, 0.0),
                "Angle": tree.math("MULTIPLY", lookup.angle, -1.0),
            }
            detail = tree.add("VectorRotate", inputs, rotation_type="Z_AXIS").outputs[0]
        return Texel(color.outputs["Color"], detail, other.outputs["Alpha"])

    def _variation(self, maps: PbrMaps, variation: Variation) -> Socket | None:
        """Return a slow change of colour around 1, which hides that textures repeat."""
        if not self._level.tables.varies:
            return None
        tree = self._tree
        size_m = variation.scale_m or maps.tile_m * VARIATION_TILES
        image = self._images.height(self._level.seen(maps, size_m))
        texel = tree.add("TexImage", {"Vector": self._position}, image=image)
        # The node's own mapping is one matrix; a node that rotates takes sine and cosine each time.
        texel.texture_mapping.rotation[2] = VARIATION_TURN_RAD
        texel.texture_mapping.scale = (1.0 / size_m,) * 3
        ranges = np.array([1, 1, 1]) * variation.brightness + np.array([1, 0, -1]) * variation.tint
        least = tuple((1 - ranges / 2).tolist())
        return tree.vector("MULTIPLY_ADD", texel.outputs["Color"], tuple(ranges.tolist()), least)


def _layer_surface(
    tree: NodeTree, level: MaterialLevel, axes: tuple[int, int] | None, layer: TerrainLayer
) -> Socket:
    return LayerNodes(tree, level, axes).surface(layer)


def ground_material(material: TerrainMaterial, images: ImageStore) -> Any:
    """Return the material of the ground.

    Levels and layers are node groups: Blender goes through a whole tree whenever a node is added.
    """
    result = new_material("ground")
    tree = NodeTree(node_tree_of(result))
    maps, variation = material.layers[0].maps, material.variation
    tables = MaterialTables(
        masks=mask_images(material),
        tilings={},
        glossy={id(layer.maps): is_glossy(layer.maps) for layer in material.layers},
        varies=bool(variation.brightness or variation.tint) and bool(np.ptp(maps.height)),
    )
    footprints_m = _footprints_m(material)
    levels = [MaterialLevel(material, images, tables, footprint_m) for footprint_m in footprints_m]
    surfaces = [
        in_group(tree, "ground_level", partial(level_surface, level=level)) for level in levels
    ]
    _, veil = through_haze(tree, (0.0, 0.0, 0.0, 1.0))
    surface = by_footprint(tree, footprints_m[1:], surfaces)
    # An image of the whole ground has no colour that goes for all of it.
    if not any(layer.label_image is not None for layer in material.layers):
        mean = in_group(tree, "ground_mean", partial(_mean_surface, level=levels[-1]))
        surface = without_detail(tree, surface, mean)
    show(tree, surface, veil)
    return result


def _mean_surface(tree: NodeTree, level: MaterialLevel) -> Socket:
    """Return the ground with layers of one colour each."""
    position = tree.add("NewGeometry").outputs["Position"]
    shares = layer_shares(tree, level.material, level.tables.masks, position)
    maps = [layer.maps for layer in level.material.layers]
    first, *others = ((*mean_color(level.images.levels(each)[-1]), 1.0) for each in maps)
    color: Socket = first
    for other, share in zip(others, shares, strict=True):
        color = tree.color_mix(share, color, other).outputs[MIX_RESULT]
    roughness = float(np.mean([each.roughness.mean() for each in maps])) / 255
    return tree.add("BsdfDiffuse", {"Color": color, "Roughness": roughness}).outputs[0]


def _footprints_m(material: TerrainMaterial) -> list[float]:
    """Return the sizes of a pixel on the ground from which on textures show another level."""
    sets = [layer.maps for layer in material.layers]
    finest_m = min(maps.tile_m / len(maps.color_srgb) for maps in sets)
    coarsest_m = max(maps.tile_m / LEAST_PX for maps in sets)
    octaves = max(0, round(log2(coarsest_m / finest_m)))
    lookups = sum(LOOKUPS[type(layer.tiling)] for layer in material.layers)
    lookups *= 3 if material.projects_sides else 1
    stride = 1 if lookups * octaves <= MAX_LOOKUPS else 2
    return [finest_m * 2**step for step in range(0, octaves + 1, stride)]


def _contrast(tree: NodeTree, weights: list[Socket]) -> Socket:
    """Return the factor that gives a mixture the variance of its parts again."""
    squares: Socket = 0.0
    for weight in weights:
        squares = tree.math("MULTIPLY_ADD", weight, weight, squares)
    return tree.math("INVERSE_SQRT", squares)


def _mixture(
    tree: NodeTree,
    parts: list[Socket],
    weights: list[Socket],
    gain: Socket,
    mean: tuple[float, float, float],
) -> Socket:
    """Return the weighted sum of parts, its distance from their mean times a factor."""
    total: Socket = tuple(-value for value in mean)
    for part, weight in zip(parts, weights, strict=True):
        total = tree.vector("MULTIPLY_ADD", part, weight, total)
    return tree.vector("MULTIPLY_ADD", total, gain, mean)
