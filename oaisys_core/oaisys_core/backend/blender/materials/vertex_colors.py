"""Materials of meshes that bring their own colours, by vertices or by a picture."""

from __future__ import annotations

from typing import Any

import numpy as np

from oaisys_core.backend.blender.compat import node_tree_of
from oaisys_core.backend.blender.materials.images import BYTE, new_image
from oaisys_core.backend.blender.materials.nodes import NodeTree, Socket
from oaisys_core.backend.blender.materials.surfaces import diffuse, new_material, show
from oaisys_core.scene import MeshPrototype

PAINT = "paint"
"""Name of a mesh's colour attribute or texture coordinates."""

ROUGHNESS = 0.5


def painted_material(prototype: MeshPrototype, mesh: Any) -> Any | None:
    """Return the material of a mesh's own colours, which are put into it; None without any."""
    if prototype.color_image_srgb is not None and prototype.uv is not None:
        result = new_material(prototype.name)
        tree = NodeTree(node_tree_of(result))
        color = _from_picture(tree, prototype, mesh)
    elif prototype.vertex_colors_srgb is not None:
        result = new_material(prototype.name)
        tree = NodeTree(node_tree_of(result))
        color = _from_vertices(tree, prototype, mesh)
    else:
        return None
    show(tree, *diffuse(tree, color, ROUGHNESS, None))
    return result


def _from_picture(tree: NodeTree, prototype: MeshPrototype, mesh: Any) -> Socket:
    rgb = np.asarray(prototype.color_image_srgb)
    layer = mesh.uv_layers.new(name=PAINT)
    layer.uv.foreach_set("vector", np.ascontiguousarray(prototype.uv, np.float32).ravel())
    pixels = np.ones((*rgb.shape[:2], 4), dtype=np.float32)
    np.multiply(rgb[::-1], BYTE, out=pixels[..., :3])
    image = new_image(prototype.name, pixels, is_float=False, is_color=True)
    place = tree.add("UVMap", uv_map=PAINT).outputs[0]
    return tree.add("TexImage", {"Vector": place}, image=image).outputs["Color"]


def _from_vertices(tree: NodeTree, prototype: MeshPrototype, mesh: Any) -> Socket:
    rgb = np.asarray(prototype.vertex_colors_srgb)
    rgba = np.ones((len(rgb), 4), dtype=np.float32)
    np.multiply(rgb, BYTE, out=rgba[:, :3])
    layer = mesh.color_attributes.new(PAINT, "BYTE_COLOR", "POINT")
    layer.data.foreach_set("color_srgb", rgba.ravel())
    return tree.add("Attribute", attribute_name=PAINT).outputs["Color"]
