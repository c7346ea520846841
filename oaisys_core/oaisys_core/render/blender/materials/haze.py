"""Haze in materials: attenuation and airlight by distance from the camera (Koschmieder's law).

It is the closed form of single scattering in homogeneous air, without the noise and the time of a
volume shader.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from oaisys_core.procedural.environment.light import veil_radiance
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.scene.sky import Color, Haze, Sky

GROUP = "haze"
"""Node group that all materials share, so that a change of haze rebuilds none of them."""

COLOR, AIRLIGHT = 0, 1
"""Outputs of the group."""


def through_haze(tree: NodeTree, color: Any) -> tuple[Socket, Socket]:
    """Return a colour attenuated by haze, and the airlight that the surface must emit in addition.

    Only camera rays see haze. Call `without_light_sampling` for the material as well.
    """
    node = tree.add("Group", node_tree=_group())
    tree.connect(color, node.inputs[0])
    return node.outputs[COLOR], node.outputs[AIRLIGHT]


def without_light_sampling(material: Any) -> None:
    """Keep Cycles from sampling every triangle of a material with airlight as a lamp."""
    material.cycles.emission_sampling = "NONE"


def set_haze(sky: Sky) -> None:
    """Set the haze of all materials."""
    group = _group()
    group.nodes.clear()
    tree = NodeTree(group)
    color = group.nodes.new("NodeGroupInput").outputs[0]
    output = group.nodes.new("NodeGroupOutput")
    airlight: Any = None
    if sky.haze is not None:
        color, airlight = _before_materials(tree, color, sky.haze, veil_radiance(sky, sky.haze))
    group.links.new(color, output.inputs[COLOR])
    if airlight is not None:
        group.links.new(airlight, output.inputs[AIRLIGHT])


def clear_share(tree: NodeTree, haze: Haze, distance_m: Socket) -> Socket:
    """Return the transmittance of the air, by colour, over a distance."""
    factor = -np.array(haze.extinction_per_m) / np.log(2.0)
    # As a power of two, because there is no vector operation for exponentials.
    return tree.vector("POWER", 2.0, tree.scale(tuple(factor.tolist()), distance_m))


def _before_materials(
    tree: NodeTree, color: Socket, haze: Haze, airlight: Color
) -> tuple[Socket, Socket]:
    away_m = tree.add("CameraData").outputs["View Distance"]
    seen_m = tree.math("MULTIPLY", away_m, tree.add("LightPath").outputs["Is Camera Ray"])
    clear = clear_share(tree, haze, seen_m)
    hidden = tree.vector("SUBTRACT", 1.0, clear)
    return tree.vector("MULTIPLY", color, clear), tree.vector("MULTIPLY", hidden, airlight)


def _group() -> Any:
    group = bpy.data.node_groups.get(GROUP)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    # Keeps it through a purge between two worlds.
    group.use_fake_user = True
    for name, direction in (("Color", "INPUT"), ("Color", "OUTPUT"), ("Airlight", "OUTPUT")):
        socket = group.interface.new_socket(name, in_out=direction, socket_type="NodeSocketColor")
        socket.default_value = (0.0, 0.0, 0.0, 1.0)
    nodes = group.nodes
    group.links.new(nodes.new("NodeGroupInput").outputs[0], nodes.new("NodeGroupOutput").inputs[0])
    return group
