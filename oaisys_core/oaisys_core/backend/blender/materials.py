"""Materials: the ground's blended layers, rocks textured from three sides, plain colours."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from oaisys_core.backend.blender.compat import node_tree_of
from oaisys_core.backend.blender.haze import through_haze, without_light_sampling
from oaisys_core.backend.blender.images import ImageStore, new_image
from oaisys_core.backend.blender.nodes import NodeTree, Socket
from oaisys_core.backend.shading import linear
from oaisys_core.scene import PbrMaps, TerrainMaterial

CHANNELS = 4
"""Masks that one image holds."""

BOX_BLEND = 0.25
"""Share of a rock's surface over which projections from two sides run into each other."""

ROCK_BUMP_M = 0.02
"""Height that a rock texture's full range stands for."""

ROCK_BRIGHTNESS = (0.85, 0.3)
"""Least brightness of a rock, and how much more it may have at random."""

VARIATION = 0.35
"""Range of the slow change of the ground's brightness, around 1."""

VARIATION_TILES = 7.3
VARIATION_TURN_RAD = 0.65
"""Size, in tiles of the first layer, and direction of the pattern that this change follows: so
that the two never repeat together."""


def ground_material(material: TerrainMaterial, images: ImageStore) -> Any:
    """Return the material of the ground: layers weighted by their masks.

    The ground lies in ``map``, so object coordinates are metres there.
    """
    result = _new_material("ground")
    tree = NodeTree(node_tree_of(result))
    position = tree.add("TexCoord").outputs["Object"]
    weights = _weights(tree, material, position)
    color: Socket = (0.0, 0.0, 0.0)
    detail: Socket = (0.0, 0.0, 0.0)
    roughness: Socket = 0.0
    for layer, weight in zip(material.layers, weights, strict=True):
        maps = layer.maps
        place = tree.scaled(position, 1.0 / maps.tile_m)
        texel = tree.add("TexImage", {"Vector": place}, image=images.color(maps))
        color = tree.vector("MULTIPLY_ADD", texel.outputs["Color"], weight, color)
        texel = tree.add("TexImage", {"Vector": place}, image=images.normal_roughness(maps))
        detail = tree.vector("MULTIPLY_ADD", texel.outputs["Color"], weight, detail)
        roughness = tree.math("MULTIPLY_ADD", texel.outputs["Alpha"], weight, roughness)
    color = tree.scaled(color, _variation(tree, material.layers[0].maps, images, position))
    slope = tree.vector("MULTIPLY_ADD", detail, (2.0, 2.0, 0.0), (-1.0, -1.0, 0.0))
    normal = tree.vector("ADD", tree.add("NewGeometry").outputs["Normal"], slope)
    _finish(tree, color, roughness, tree.vector("NORMALIZE", normal))
    return result


def rock_material(maps: PbrMaps, images: ImageStore) -> Any:
    """Return a material that projects a texture from three sides.

    An object's colour holds its scale, so that a texel has one size on all rocks; its place
    shifts the texture, so that no two look alike.
    """
    result = _new_material(maps.name)
    tree = NodeTree(node_tree_of(result))
    info = tree.add("ObjectInfo")
    position = tree.vector(
        "MULTIPLY_ADD",
        tree.add("TexCoord").outputs["Object"],
        info.outputs["Color"],
        info.outputs["Location"],
    )
    place = tree.scaled(position, 1.0 / maps.tile_m)
    color = _box(tree, images.color(maps), place).outputs["Color"]
    height = _box(tree, images.height(maps), place).outputs["Color"]
    bump = tree.add("Bump", {"Height": height, "Distance": ROCK_BUMP_M, "Strength": 1.0})
    least, range_ = ROCK_BRIGHTNESS
    brightness = tree.math("MULTIPLY_ADD", info.outputs["Random"], range_, least)
    _finish(
        tree,
        tree.scaled(color, brightness),
        float(maps.roughness.mean()) / 255,
        bump.outputs["Normal"],
    )
    return result


def plain_material(color_srgb: tuple[float, float, float]) -> Any:
    """Return a dull material of one colour."""
    result = _new_material("plain")
    red, green, blue = linear(color_srgb)
    _finish(NodeTree(node_tree_of(result)), (red, green, blue, 1.0), 0.5, None)
    return result


def _new_material(name: str) -> Any:
    material = bpy.data.materials.new(name)
    without_light_sampling(material)
    return material


def _weights(tree: NodeTree, material: TerrainMaterial, position: Socket) -> list[Socket]:
    """Return one socket per layer with its weight at ``position``."""
    x0, y0, x1, y1 = material.extent_m
    size_inverse = (1.0 / (x1 - x0), 1.0 / (y1 - y0), 0.0)
    place = tree.vector(
        "MULTIPLY_ADD", position, size_inverse, (-x0 / (x1 - x0), -y0 / (y1 - y0), 0.0)
    )
    sockets: list[Socket] = []
    masks = material.masks
    for first in range(0, len(masks), CHANNELS):
        part = masks[first : first + CHANNELS]
        pixels = np.zeros((*masks.shape[1:], CHANNELS), dtype=np.float32)
        pixels[..., : len(part)] = np.moveaxis(part, 0, -1)
        image = new_image(f"masks_{first}", pixels, is_float=True, is_color=False)
        texel = tree.add("TexImage", {"Vector": place}, image=image, extension="EXTEND")
        channels = tree.add("SeparateColor", {"Color": texel.outputs["Color"]})
        sockets.extend([*channels.outputs, texel.outputs["Alpha"]][: len(part)])
    return sockets


def _variation(tree: NodeTree, maps: PbrMaps, images: ImageStore, position: Socket) -> Socket:
    """Return a slowly varying brightness around 1, which hides that textures repeat."""
    turned = tree.add(
        "VectorRotate", {"Vector": position, "Angle": VARIATION_TURN_RAD}, rotation_type="Z_AXIS"
    ).outputs[0]
    place = tree.scaled(turned, 1.0 / (maps.tile_m * VARIATION_TILES))
    texel = tree.add("TexImage", {"Vector": place}, image=images.height(maps))
    return tree.math("MULTIPLY_ADD", texel.outputs["Color"], VARIATION, 1.0 - VARIATION / 2)


def _box(tree: NodeTree, image: Any, place: Socket) -> Any:
    return tree.add(
        "TexImage", {"Vector": place}, image=image, projection="BOX", projection_blend=BOX_BLEND
    )


def _finish(tree: NodeTree, color: Any, roughness: Any, normal: Socket | None) -> None:
    """Add a diffuse surface in hazy air, and the output.

    On dry ground, gloss costs noise and shows nothing.
    """
    color, veil = through_haze(tree, color)
    inputs: dict[str | int, Any] = {"Color": color, "Roughness": roughness}
    if normal is not None:
        inputs["Normal"] = normal
    surface = tree.add("BsdfDiffuse", inputs).outputs[0]
    air = tree.add("Emission", {"Color": veil}).outputs[0]
    both = tree.add("AddShader", {0: surface, 1: air}).outputs[0]
    tree.add("OutputMaterial", {"Surface": both})
