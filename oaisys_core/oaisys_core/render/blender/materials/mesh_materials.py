"""Materials of meshes from files: images, vertex colours and cut-outs."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.render.blender.compat import node_tree_of
from oaisys_core.render.blender.materials.images import BYTE, new_image
from oaisys_core.render.blender.materials.nodes import MIX_RESULT, NodeTree, Socket
from oaisys_core.render.blender.materials.surfaces import (
    PAINT,
    diffuse,
    new_material,
    paint_vertices,
)
from oaisys_core.render.shading.looks import OBJECT_ROUGHNESS
from oaisys_core.scene import MeshMaterial, MeshPrototype, Wrap

UV = "uv"
"""Name of a mesh's texture coordinates."""

CUT_OUT = "oaisys_cut_out"
"""Property of materials that let light through where the mesh is cut out."""

CUT_OUT_LAYERS = 256
"""How many holes light may pass."""


def add_materials(prototype: MeshPrototype, mesh: Any) -> None:
    """Give a mesh the materials of its prototype, which has at least one."""
    if prototype.uv is not None:
        layer = mesh.uv_layers.new(name=UV)
        layer.uv.foreach_set("vector", np.ascontiguousarray(prototype.uv, np.float32).ravel())
    is_painted = prototype.vertex_colors_srgb is not None and bool(prototype.materials)
    if is_painted:
        paint_vertices(prototype, mesh, None)
    for material in prototype.image_materials:
        mesh.materials.append(_material(material, is_painted))
    if prototype.material_of is not None:
        mesh.polygons.foreach_set("material_index", prototype.material_of.astype(np.int32))


def has_cut_outs() -> bool:
    """Return whether a material that is in use lets light through where it is cut out."""
    return any(CUT_OUT in each and each.users for each in bpy.data.materials)


def _material(material: MeshMaterial, is_painted: bool) -> Any:
    result = new_material(material.name or "mesh")
    tree = NodeTree(node_tree_of(result))
    color: Any = (*linear(material.color_srgb), 1.0)
    if material.color_image_srgb is not None:
        pixels = material.color_image_srgb
        color = _lookup(tree, material, pixels, is_color=True)
    if is_painted:
        paint = tree.add("Attribute", attribute_name=PAINT).outputs["Color"]
        mixed = tree.color_mix(1.0, color, paint)
        mixed.blend_type = "MULTIPLY"
        color = mixed.outputs[MIX_RESULT]
    surface, airlight = diffuse(tree, color, OBJECT_ROUGHNESS, None)
    air = tree.add("Emission", {"Color": airlight}).outputs[0]
    surface = tree.add("AddShader", {0: surface, 1: air}).outputs[0]
    if material.opacity is not None:
        result[CUT_OUT] = True
        grey = np.repeat(material.opacity[..., None], 3, axis=2)
        opacity = _lookup(tree, material, grey, is_color=False)
        # Half a thousandth of a byte, because a float32 may fall short of the byte itself.
        least = (material.cutoff - 5e-4) / 255
        is_solid = tree.math("GREATER_THAN", tree.component(opacity, 0), least)
        surface = tree.mix(is_solid, tree.add("BsdfTransparent").outputs[0], surface)
    tree.add("OutputMaterial", {"Surface": surface})
    return result


def _lookup(
    tree: NodeTree, material: MeshMaterial, rgb: NDArray[np.uint8], *, is_color: bool
) -> Socket:
    """Return the colours of an image at a mesh's texture coordinates."""
    pixels = np.ones((*rgb.shape[:2], 4), dtype=np.float32)
    np.multiply(rgb[::-1], BYTE, out=pixels[..., :3])
    image = new_image(material.name or "mesh", pixels, is_float=False, is_color=is_color)
    place = tree.add("UVMap", uv_map=UV).outputs[0]
    if material.wrap != ("repeat", "repeat"):
        axes = zip(material.wrap, (rgb.shape[1], rgb.shape[0]), (0, 1), strict=True)
        u, v = (_wrap(tree, tree.component(place, axis), how, n) for how, n, axis in axes)
        place = tree.combine(u, v, 0.0)
    return tree.add("TexImage", {"Vector": place}, image=image).outputs["Color"]


def _wrap(tree: NodeTree, at: Socket, wrap: Wrap, size: int) -> Socket:
    """Return the coordinate at which an image that repeats shows the same."""
    if wrap == "repeat":
        return at
    if wrap == "mirror":
        at = tree.math("PINGPONG", at, 1.0)
    return tree.math("MAXIMUM", tree.math("MINIMUM", at, 1 - 0.5 / size), 0.5 / size)
