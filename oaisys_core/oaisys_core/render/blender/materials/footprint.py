"""The size of a pixel on a surface, by which materials choose the level of their textures."""

from __future__ import annotations

from typing import Any

import bpy

from oaisys_core.render.shading.looks import TEXEL_PX, pixel_angle_rad
from oaisys_core.types import PinholeIntrinsics

PIXEL_ANGLE = "pixel_angle_rad"
"""Property of all objects with the angle of a pixel. Cycles compiles all materials again if a
number in one of them changes, which takes seconds; a property of an object is read at render."""

FOOTPRINT = "footprint"
"""Node group with the size of a pixel on the surface."""


def set_pixel_angle(intrinsics: PinholeIntrinsics) -> None:
    """Tell materials the largest texel, see `pixel_angle_rad`, unless it is similar to now."""
    wanted = pixel_angle_rad(intrinsics, TEXEL_PX)
    for thing in bpy.context.scene.objects:
        if thing.type == "MESH" and abs(thing.get(PIXEL_ANGLE, 0.0) - wanted) > 1e-6 * wanted:
            thing[PIXEL_ANGLE] = wanted
            thing.update_tag(refresh={"OBJECT"})


def footprint_group() -> Any:
    """Return the node group whose output is the size in metres of a pixel on the surface."""
    group: Any = bpy.data.node_groups.get(FOOTPRINT)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(FOOTPRINT, "ShaderNodeTree")
    group.interface.new_socket("Metres", in_out="OUTPUT", socket_type="NodeSocketFloat")
    nodes, links = group.nodes, group.links
    times_angle = nodes.new("ShaderNodeMath")
    times_angle.operation = "MULTIPLY"
    camera, angle = nodes.new("ShaderNodeCameraData"), nodes.new("ShaderNodeAttribute")
    # Instances have no property of their own, but that of the object which makes them.
    angle.attribute_type, angle.attribute_name = "INSTANCER", PIXEL_ANGLE
    links.new(camera.outputs["View Distance"], times_angle.inputs[0])
    links.new(angle.outputs["Fac"], times_angle.inputs[1])
    links.new(times_angle.outputs[0], nodes.new("NodeGroupOutput").inputs[0])
    return group
