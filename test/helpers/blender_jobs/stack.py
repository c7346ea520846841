"""How much of the stack of Cycles' shaders the ground's material takes, measured from outside.

Numbers that nothing but the test needs are kept on the stack while the material is evaluated. The
most of them with which Cycles still compiles the material is what is free.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from typing import Any

import bpy

from oaisys_core.render.blender.materials.ground.material import GroundMaterials
from oaisys_core.render.blender.materials.haze import set_haze
from oaisys_core.render.blender.materials.images import ImageStore
from oaisys_core.render.blender.materials.photometric import set_law
from oaisys_core.scene.sky import Sky
from oaisys_core.scene.terrain_material import TerrainMaterial

STACK = 255
"""Numbers on the stack of a shader (SVM_STACK_SIZE in Cycles)."""

NOTHING: dict[str | int, Any] = {}

TOO_BIG = "out of SVM stack space"
STEP = 4
"""How near `stack_use` comes, from above: each halving of it takes a render more."""


def stack_use(materials: Sequence[TerrainMaterial], sky: Sky) -> list[int]:
    """Return how many numbers each material of a stage under a sky keeps at most."""
    return [_use(_padded(material, sky)) for material in materials]


def keeps_at_most(
    materials: Sequence[TerrainMaterial], bounds: Sequence[int], sky: Sky
) -> list[bool]:
    """Return whether each material keeps at most as many numbers as its bound: one render each."""
    return [
        _fits(_padded(material, sky), STACK - bound)
        for material, bound in zip(materials, bounds, strict=True)
    ]


def _padded(material: TerrainMaterial, sky: Sky) -> _Padding:
    """Return the padding of a material that is rendered on a mesh under a sky."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.render.resolution_x = scene.render.resolution_y = 4
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    mesh = bpy.data.meshes.new("ground")
    mesh.from_pydata([(-5, -5, -9), (5, -5, -9), (0, 5, -8)], [], [(0, 1, 2)])
    for each in (scene.camera, bpy.data.objects.new("ground", mesh)):
        scene.collection.objects.link(each)
    ground = GroundMaterials(material, ImageStore(), has_tracks=True).stage
    set_haze(sky)
    set_law(material.law, sky)
    mesh.materials.append(ground)
    return _Padding(ground)


def _use(padding: _Padding) -> int:
    least, most = -1, STACK
    while most - least > STEP:
        middle = (least + most) // 2
        if _fits(padding, middle):
            least = middle
        else:
            most = middle
    return STACK - least


def _fits(padding: _Padding, count: int) -> bool:
    padding.keep(count)
    return TOO_BIG not in _standard_error_of_a_render()


def _standard_error_of_a_render() -> str:
    saved = os.dup(2)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            bpy.ops.render.render()
        finally:
            os.dup2(saved, 2)
            os.close(saved)
        file.seek(0)
        return file.read().decode()


class _Padding:
    """Numbers that a mixture around a material's surface needs before it and after it."""

    def __init__(self, material: Any) -> None:
        self._tree = material.node_tree
        (self._end,) = (n for n in self._tree.nodes if n.type == "OUTPUT_MATERIAL")
        self._surface = self._end.inputs["Surface"].links[0].from_socket
        self._nodes: list[Any] = []

    def keep(self, count: int) -> None:
        """Keep ``count`` numbers instead of those before."""
        for node in self._nodes:
            self._tree.nodes.remove(node)
        self._nodes = []
        surface = self._surface
        if count:
            sizes = [1 << bit for bit in range(count.bit_length()) if count >> bit & 1]
            groups = [self._new("ShaderNodeGroup") for _ in sizes]
            for group, size in zip(groups, sizes, strict=True):
                group.node_tree = _numbers(size)
            before = self._least([group.outputs[0] for group in groups])
            after = self._least([group.outputs[1] for group in groups])
            shown = self._new("ShaderNodeEmission", {"Color": after}).outputs[0]
            inputs: dict[str | int, Any] = {"Fac": before, 1: surface, 2: shown}
            surface = self._new("ShaderNodeMixShader", inputs).outputs[0]
        self._tree.links.new(surface, self._end.inputs["Surface"])

    def _least(self, sockets: Sequence[Any]) -> Any:
        least = sockets[0]
        for socket in sockets[1:]:
            node = self._new("ShaderNodeMath", {0: least, 1: socket})
            node.operation = "MINIMUM"
            least = node.outputs[0]
        return least

    def _new(self, kind: str, inputs: dict[str | int, Any] = NOTHING) -> Any:
        node = self._tree.nodes.new(kind)
        self._nodes.append(node)
        for name, socket in inputs.items():
            self._tree.links.new(socket, node.inputs[name])
        return node


def _numbers(size: int) -> Any:
    """Return a group with the least of ``size`` numbers, by two ways that share nothing else."""
    name = f"padding_{size}"
    if name in bpy.data.node_groups:
        return bpy.data.node_groups[name]
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    nodes, links = group.nodes, group.links
    place = nodes.new("ShaderNodeNewGeometry").outputs["Position"]
    parts = nodes.new("ShaderNodeSeparateXYZ")
    links.new(place, parts.inputs[0])
    end = nodes.new("NodeGroupOutput")
    numbers = []
    for index in range(size):
        node = nodes.new("ShaderNodeMath")
        links.new(parts.outputs[0], node.inputs[0])
        # Of its own, or Cycles would merge them.
        node.operation, node.inputs[1].default_value = "MULTIPLY", size + index / 300
        numbers.append(node.outputs[0])
    for way, operation in enumerate(("MAXIMUM", "MINIMUM")):
        group.interface.new_socket(operation, in_out="OUTPUT", socket_type="NodeSocketFloat")
        result = numbers[0]
        for number in numbers[1:]:
            node = nodes.new("ShaderNodeMath")
            node.operation = operation
            links.new(result, node.inputs[0])
            links.new(number, node.inputs[1])
            result = node.outputs[0]
        links.new(result, end.inputs[way])
    return group
