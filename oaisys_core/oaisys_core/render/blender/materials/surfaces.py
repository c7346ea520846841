"""Materials of objects, and the surfaces that these share with the ground."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.render.blender.compat import node_tree_of
from oaisys_core.render.blender.materials.contact import with_dust
from oaisys_core.render.blender.materials.haze import through_haze, without_light_sampling
from oaisys_core.render.blender.materials.images import BYTE, ImageStore
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.render.blender.objects.instances import SIZE
from oaisys_core.render.shading.looks import (
    BOX_BLEND,
    DULL,
    IOR,
    OBJECT_ROUGHNESS,
    ROCK_BRIGHTNESS,
    ROCK_BUMP_M,
    SHINY,
)
from oaisys_core.render.shading.shading import mean_color
from oaisys_core.scene import MeshPrototype, PbrMaps

PAINT = "paint"
"""Name of a mesh's colour attribute."""

BY_CHANCE = 1
"""Index of materials whose samples are reflected or let through by chance, see `postprocessing`."""

GROUND = 2
"""Index of the ground's materials."""


def rock_material(maps: PbrMaps, images: ImageStore, dust_m: float) -> Any:
    """Return a material that projects a texture from three sides (box projection).

    Texels have the same size on rocks of all scales. A rock's position shifts the texture, so that
    no two rocks look alike. ``dust_m`` is that of the prototype.
    """
    result = new_material(maps.name)
    tree = NodeTree(node_tree_of(result))
    info = tree.add("ObjectInfo")
    position = tree.vector(
        "MULTIPLY_ADD",
        tree.add("TexCoord").outputs["Object"],
        tree.add("Attribute", attribute_type="INSTANCER", attribute_name=SIZE).outputs["Fac"],
        info.outputs["Location"],
    )
    place = tree.scale(position, 1.0 / maps.tile_m)
    least, range_ = ROCK_BRIGHTNESS
    brightness = tree.math("MULTIPLY_ADD", info.outputs["Random"], range_, least)
    airlight: Socket = None
    surfaces = []
    levels = images.levels(maps)
    for level in levels:
        color = tree.scale(_box(tree, images.color(level), place).outputs["Color"], brightness)
        height = _box(tree, images.height(level), place).outputs["Color"]
        if dust_m:
            color = with_dust(tree, color, height, dust_m)
        bump = tree.add("Bump", {"Height": height, "Distance": ROCK_BUMP_M, "Strength": 1.0})
        roughness = float(level.roughness.mean()) / 255
        surface, airlight = diffuse(tree, color, roughness, bump.outputs[0])
        surfaces.append(surface)
    texel_m = maps.tile_m / len(maps.color_srgb)
    bounds_m = [texel_m * 2**step for step in range(1, len(levels))]
    seen = tree.by_footprint(bounds_m, surfaces)
    red, green, blue = mean_color(levels[-1])
    color = tree.scale((red, green, blue), brightness)
    mean = tree.add("BsdfDiffuse", {"Color": color, "Roughness": roughness}).outputs[0]
    show(tree, without_detail(tree, seen, mean), airlight)
    return result


def without_detail(tree: NodeTree, seen: Socket, mean: Socket) -> Socket:
    """Return a surface that diffuse rays see as ``mean``, without texture lookups.

    Indirect light from a surface hardly depends on its detail.
    """
    return tree.mix(tree.add("LightPath").outputs["Is Diffuse Ray"], seen, mean)


def plain_material(color_srgb: tuple[float, float, float]) -> Any:
    """Return a diffuse material of one colour."""
    result = new_material("plain")
    red, green, blue = linear(color_srgb)
    tree = NodeTree(node_tree_of(result))
    show(tree, *diffuse(tree, (red, green, blue, 1.0), 0.5, None))
    return result


def new_material(name: str) -> Any:
    """Return an empty material."""
    material = bpy.data.materials.new(name)
    without_light_sampling(material)
    return material


def _box(tree: NodeTree, image: Any, place: Socket) -> Any:
    return tree.add(
        "TexImage", {"Vector": place}, image=image, projection="BOX", projection_blend=BOX_BLEND
    )


def diffuse(
    tree: NodeTree, color: Any, roughness: Any, normal: Socket | None
) -> tuple[Socket, Socket]:
    """Return a diffuse surface seen through haze, and the airlight in front of it."""
    color, airlight = through_haze(tree, color)
    inputs: dict[str | int, Any] = {"Color": color, "Roughness": roughness}
    if normal is not None:
        inputs["Normal"] = normal
    return tree.add("BsdfDiffuse", inputs).outputs[0], airlight


def show(tree: NodeTree, surface: Socket, airlight: Socket, height_m: Socket = None) -> None:
    """Make a surface, plus the airlight in front of it, the output of a material.

    A height bends the surface's normals, as if it were raised; its shape stays.
    """
    air = tree.add("Emission", {"Color": airlight}).outputs[0]
    both = tree.add("AddShader", {0: surface, 1: air}).outputs[0]
    outputs: dict[str | int, Any] = {"Surface": both}
    if height_m is not None:
        # Materials displace no geometry unless they are told to.
        inputs: dict[str | int, Any] = {"Height": height_m, "Midlevel": 0.0, "Scale": 1.0}
        outputs["Displacement"] = tree.add("Displacement", inputs).outputs[0]
    tree.add("OutputMaterial", outputs)


def color_material(prototype: MeshPrototype, mesh: Any) -> Any | None:
    """Return a material of a prototype's vertex colours, stored in its mesh; None without any."""
    if prototype.vertex_colors_srgb is None:
        return None
    result = new_material(prototype.name)
    tree = NodeTree(node_tree_of(result))
    color = _from_vertices(tree, prototype, mesh)
    if prototype.dust_m:
        color = with_dust(tree, color, 0.5, prototype.dust_m)
    show(tree, *diffuse(tree, color, OBJECT_ROUGHNESS, None))
    return result


def _from_vertices(tree: NodeTree, prototype: MeshPrototype, mesh: Any) -> Socket:
    paint_vertices(prototype, mesh, None)
    return tree.add("Attribute", attribute_name=PAINT).outputs["Color"]


def paint_vertices(prototype: MeshPrototype, mesh: Any, alpha: NDArray[np.uint8] | None) -> None:
    """Store a prototype's vertex colours, with (V,) bytes of alpha, as the attribute `PAINT`."""
    rgb = np.asarray(prototype.vertex_colors_srgb)
    rgba = np.ones((len(rgb), 4), dtype=np.float32)
    np.multiply(rgb, BYTE, out=rgba[:, :3])
    if alpha is not None:
        np.multiply(alpha, BYTE, out=rgba[:, 3])
    layer = mesh.color_attributes.new(PAINT, "BYTE_COLOR", "POINT")
    layer.data.foreach_set("color_srgb", rgba.ravel())


def add_gloss(tree: NodeTree, surface: Socket, roughness: Socket, normal: Socket) -> Socket:
    """Return a surface under a film of water or ice that reflects by Fresnel's law.

    Args:
        tree: The material's.
        surface: Below the film.
        roughness: 0 to 1; the film fades out between `SHINY` and `DULL`.
        normal: In ``map``, unit length.
    """
    slope = 1 / (DULL - SHINY)
    film = tree.clamp("MULTIPLY_ADD", roughness, -slope, DULL * slope)
    fresnel = tree.add("Fresnel", {"IOR": IOR, "Normal": normal}).outputs[0]
    seen, _ = through_haze(tree, (1.0, 1.0, 1.0, 1.0))
    inputs: dict[str | int, Socket] = {"Color": seen, "Roughness": roughness, "Normal": normal}
    mirror = tree.add("BsdfGlossy", inputs).outputs[0]
    share = tree.math("MULTIPLY", fresnel, film)
    return tree.free_factor(share, tree.mix(share, surface, mirror))
