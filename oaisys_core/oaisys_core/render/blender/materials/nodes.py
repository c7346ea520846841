"""Concise construction of Blender's shader node trees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy

from oaisys_core.render.blender.materials.footprint import footprint_group

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

    def scale(self, vector: Any, factor: Any) -> Socket:
        """Return a vector times a scalar."""
        node = self.add("VectorMath", {0: vector, "Scale": factor}, operation="SCALE")
        return node.outputs[0]

    def clamp(self, operation: str, *operands: Any) -> Socket:
        """Return the result of a scalar operation, clamped to [0, 1]."""
        node = self.add("Math", dict(enumerate(operands)), operation=operation, use_clamp=True)
        return node.outputs[0]

    def combine(self, x: Any, y: Any, z: Any) -> Socket:
        """Return a vector of three scalars."""
        return self.add("CombineXYZ", {0: x, 1: y, 2: z}).outputs[0]

    def dot(self, first: Any, second: Any) -> Socket:
        """Return the scalar product of two vectors."""
        node = self.add("VectorMath", {0: first, 1: second}, operation="DOT_PRODUCT")
        return node.outputs["Value"]

    def component(self, vector: Any, axis: int) -> Socket:
        """Return a component of a vector or colour.

        Unlike nodes that separate all three, it leaves none on Cycles' stack that nobody uses.
        """
        unit = [0.0, 0.0, 0.0]
        unit[axis] = 1.0
        return self.dot(vector, tuple(unit))

    def mix(self, factor: Any, first: Socket, second: Socket) -> Socket:
        """Return a surface that blends from the first (factor 0) to the second (1)."""
        return self.add("MixShader", {0: factor, 1: first, 2: second}).outputs[0]

    def by_footprint(self, bounds_m: Sequence[float], surfaces: Sequence[Socket]) -> Socket:
        """Return a surface that switches from one to the next by the size of a pixel on it.

        These are levels of detail, as Cycles has no mip maps on the CPU.

        Args:
            bounds_m: Sizes in ascending order.
            surfaces: One more than bounds.
        """
        seen_m = self.add("Group", node_tree=footprint_group()).outputs[0]
        return self.by_number(seen_m, bounds_m, surfaces)

    def by_number(
        self,
        number: Socket,
        bounds: Sequence[float],
        surfaces: Sequence[Socket],
        *,
        frees_stack: bool = False,
    ) -> Socket:
        """Return a surface that switches from one to the next where a number passes a bound.

        Cycles evaluates only one of the surfaces, because their weights are 0 or 1.

        Args:
            number: What is compared.
            bounds: In ascending order.
            surfaces: One more than bounds.
            frees_stack: Whether to `free` the number that each mixture leaves on Cycles' stack.
        """
        if not bounds:
            return surfaces[0]
        middle = len(bounds) // 2
        is_beyond = self.math("GREATER_THAN", number, bounds[middle])
        halves = (
            (bounds[:middle], surfaces[: middle + 1]),
            (bounds[middle + 1 :], surfaces[middle + 1 :]),
        )
        lower, upper = (self.by_number(number, *half, frees_stack=frees_stack) for half in halves)
        mixture = self.mix(is_beyond, lower, upper)
        return self.free_factor(is_beyond, mixture) if frees_stack else mixture

    def free_factor(self, factor: Socket, mixture: Socket) -> Socket:
        """Return a mixture whose factor is taken off Cycles' stack once the mixture is evaluated.

        Cycles keeps the factor of each mixture of surfaces for good, unless another node uses it
        later. A black surface is such a node, which Cycles compiles after the mixture and drops.
        """
        black = self.add("BsdfDiffuse", {"Color": (0.0, 0.0, 0.0, 1.0), "Roughness": factor})
        return self.add("AddShader", {0: mixture, 1: black.outputs[0]}).outputs[0]


def in_group(tree: NodeTree, name: str, make: Callable[[NodeTree], Socket]) -> Socket:
    """Return a surface that ``make`` adds to a new node group, which is added to ``tree``."""
    group = node_group(name, lambda inner: [make(inner)], outputs=("Shader",))
    return tree.add("Group", node_tree=group).outputs[0]


def node_group(
    name: str,
    make: Callable[..., Sequence[Socket]],
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[str],
) -> Any:
    """Return a new node group.

    Many small trees are faster to build, because Blender visits a whole tree for each new node.

    Args:
        name: Its name.
        make: Adds the nodes to a tree, given that and the group's inputs; returns the outputs.
        inputs: Types of the inputs: `Float`, `Color`, `Vector` or `Shader`.
        outputs: Types of the outputs.
    """
    group: Any = bpy.data.node_groups.new(name, "ShaderNodeTree")
    for in_out, kinds in (("INPUT", inputs), ("OUTPUT", outputs)):
        for kind in kinds:
            group.interface.new_socket(kind, in_out=in_out, socket_type=f"NodeSocket{kind}")
    begin = group.nodes.new("NodeGroupInput").outputs[: len(inputs)] if inputs else ()
    made = make(NodeTree(group), *begin)
    end = group.nodes.new("NodeGroupOutput")
    for socket, target in zip(made, end.inputs[: len(outputs)], strict=True):
        group.links.new(socket, target)
    return group
