"""Concise construction of Blender's shader node trees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy

from oaisys_core.backend.blender.camera import footprint_group

Socket = Any
"""An output socket of a node."""


MIX_FIRST, MIX_SECOND, MIX_RESULT = 6, 7, 2
"""Indices of a mix node's colour sockets."""


class NodeTree:
    """Adds nodes to a tree and connects them."""

    def __init__(self, tree: Any) -> None:
        self._tree = tree

    def add(self, kind: str, inputs: dict[str | int, Any] | None = None, **settings: Any) -> Any:
        """Return a new node.

        Args:
            kind: Its type without the prefix ``ShaderNode``.
            inputs: By name or index: an output socket to connect, or a value.
            settings: Properties of the node.
        """
        node = self._tree.nodes.new(f"ShaderNode{kind}")
        for name, value in settings.items():
            setattr(node, name, value)
        for key, value in (inputs or {}).items():
            self.connect(value, node.inputs[key])
        return node

    def connect(self, value: Any, target: Any) -> None:
        """Connect an input socket to an output socket, or set it to a value."""
        if hasattr(value, "is_output"):
            self._tree.links.new(value, target)
        else:
            target.default_value = value

    def math(self, operation: str, *operands: Any) -> Socket:
        """Return the result of a scalar operation."""
        return self.add("Math", dict(enumerate(operands)), operation=operation).outputs[0]

    def vector(self, operation: str, *operands: Any) -> Socket:
        """Return the vector result of a vector operation; scalar operands become vectors."""
        inputs: dict[str | int, Any] = {
            index: (value,) * 3 if isinstance(value, float | int) else value
            for index, value in enumerate(operands)
        }
        return self.add("VectorMath", inputs, operation=operation).outputs[0]

    def color_mix(self, factor: Any, first: Any, second: Any) -> Any:
        """Return a node that interpolates from the first colour (factor 0) to the second (1).

        Its result is the socket of index `MIX_RESULT`, because the names of sockets are ambiguous.
        """
        inputs: dict[str | int, Any] = {"Factor": factor, MIX_FIRST: first, MIX_SECOND: second}
        return self.add("Mix", inputs, data_type="RGBA")

    def scaled(self, vector: Any, factor: Any) -> Socket:
        """Return a vector times a scalar."""
        node = self.add("VectorMath", {0: vector, "Scale": factor}, operation="SCALE")
        return node.outputs[0]

    def clamped(self, operation: str, *operands: Any) -> Socket:
        """Return the result of a scalar operation, clamped to [0, 1]."""
        node = self.add("Math", dict(enumerate(operands)), operation=operation, use_clamp=True)
        return node.outputs[0]

    def combined(self, x: Any, y: Any, z: Any) -> Socket:
        """Return a vector of three scalars."""
        return self.add("CombineXYZ", {0: x, 1: y, 2: z}).outputs[0]

    def mixed(self, factor: Any, first: Socket, second: Socket) -> Socket:
        """Return a surface that blends from the first (factor 0) to the second (1)."""
        return self.add("MixShader", {0: factor, 1: first, 2: second}).outputs[0]

    def by_footprint(self, bounds_m: Sequence[float], surfaces: Sequence[Socket]) -> Socket:
        """Return a surface that switches from one to the next by the size of a pixel on it.

        These are levels of detail, as Cycles has no mip maps on the CPU. It evaluates only one of
        the surfaces, because their weights are 0 or 1.

        Args:
            bounds_m: Sizes in ascending order.
            surfaces: One more than bounds.
        """
        if not bounds_m:
            return surfaces[0]
        middle = len(bounds_m) // 2
        seen_m = self.add("Group", node_tree=footprint_group()).outputs[0]
        is_beyond = self.math("GREATER_THAN", seen_m, bounds_m[middle])
        finer = self.by_footprint(bounds_m[:middle], surfaces[: middle + 1])
        coarser = self.by_footprint(bounds_m[middle + 1 :], surfaces[middle + 1 :])
        return self.mixed(is_beyond, finer, coarser)


def in_group(tree: NodeTree, name: str, make: Callable[[NodeTree], Socket]) -> Socket:
    """Return a surface that ``make`` adds to a new node group, which is added to ``tree``."""
    return tree.add("Group", node_tree=surface_group(name, make)).outputs[0]


def number_group(name: str, make: Callable[[NodeTree], Sequence[Socket]]) -> Any:
    """Return a new node group whose outputs are the numbers that ``make`` adds to it."""
    group: Any = bpy.data.node_groups.new(name, "ShaderNodeTree")
    numbers = make(NodeTree(group))
    for _ in numbers:
        group.interface.new_socket("Number", in_out="OUTPUT", socket_type="NodeSocketFloat")
    end = group.nodes.new("NodeGroupOutput")
    for index, number in enumerate(numbers):
        group.links.new(number, end.inputs[index])
    return group


def surface_group(name: str, make: Callable[[NodeTree], Socket]) -> Any:
    """Return a new node group whose output is a surface that ``make`` adds to it.

    Many small trees are faster to build, because Blender visits a whole tree for each new node.
    """
    group: Any = bpy.data.node_groups.new(name, "ShaderNodeTree")
    group.interface.new_socket("Surface", in_out="OUTPUT", socket_type="NodeSocketShader")
    surface = make(NodeTree(group))
    group.links.new(surface, group.nodes.new("NodeGroupOutput").inputs[0])
    return group
