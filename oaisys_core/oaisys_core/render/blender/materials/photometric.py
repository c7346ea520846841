"""The factor of a photometric law, by the direction of the sun, in materials.

Cycles' closures do not know such laws, and no closure can be written for it: so a diffuse one gets
the law's reflectance, relative to Lambert's, as a factor of its colour, for the sun that the world
has. Light of the sun is then exactly that of the law; other light sees the same factor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.render.shading.photometry import relative_to_lambert
from oaisys_core.scene.photometric_laws import PhotometricLaw
from oaisys_core.scene.sky import Sky

GROUP = "photometric_factor"
"""Node group that all levels share, so that another sun rebuilds none of them."""

OPERATIONS: dict[Callable[..., Any], str] = {
    np.add: "ADD",
    np.subtract: "SUBTRACT",
    np.multiply: "MULTIPLY",
    np.divide: "DIVIDE",
    np.power: "POWER",
    np.maximum: "MAXIMUM",
    np.minimum: "MINIMUM",
    np.absolute: "ABSOLUTE",
    np.sqrt: "SQRT",
    np.exp: "EXPONENT",
    np.arccos: "ARCCOSINE",
}
"""Blender's names of numpy's universal functions."""


class NodeValue(NDArrayOperatorsMixin):
    """A number in a node tree; numpy's functions of it add nodes."""

    def __init__(self, tree: NodeTree, socket: Socket) -> None:
        self._tree = tree
        self.socket = socket

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method != "__call__" or kwargs:
            return NotImplemented
        operands = [each.socket if isinstance(each, NodeValue) else float(each) for each in inputs]
        if ufunc is np.log:
            return NodeValue(self._tree, self._tree.math("LOGARITHM", *operands, float(np.e)))
        if ufunc not in OPERATIONS:
            return NotImplemented
        return NodeValue(self._tree, self._tree.math(OPERATIONS[ufunc], *operands))


def by_law(tree: NodeTree, color: Socket, normal: Socket) -> Socket:
    """Return the colour of a surface with a normal, times the factor of the law."""
    factor = tree.add("Group", {0: normal}, node_tree=_group()).outputs[0]
    return tree.scale(color, factor)


def set_law(law: PhotometricLaw | None, sky: Sky) -> None:
    """Set law and sun of all materials; without a law or at night the factor is 1."""
    group = _group()
    group.nodes.clear()
    output = group.nodes.new("NodeGroupOutput")
    tree = NodeTree(group)
    if law is None or sky.lamp_w_m2 <= 0:
        output.inputs[0].default_value = 1.0
        return
    normal = tree.vector("NORMALIZE", group.nodes.new("NodeGroupInput").outputs[0])
    to_eye = tree.add("NewGeometry").outputs["Incoming"]

    def cosine(first: Any, second: Any) -> NodeValue:
        return NodeValue(tree, tree.dot(first, second))

    cosines = cosine(normal, sky.to_sun), cosine(normal, to_eye), cosine(to_eye, sky.to_sun)
    tree.connect(relative_to_lambert(law, *cosines).socket, output.inputs[0])


def _group() -> Any:
    group = bpy.data.node_groups.get(GROUP)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    # Keeps it through a purge between two worlds.
    group.use_fake_user = True
    group.interface.new_socket("Normal", in_out="INPUT", socket_type="NodeSocketVector")
    group.interface.new_socket("Factor", in_out="OUTPUT", socket_type="NodeSocketFloat")
    group.nodes.new("NodeGroupOutput").inputs[0].default_value = 1.0
    return group
