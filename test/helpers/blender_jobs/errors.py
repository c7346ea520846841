"""What the tests of failed renders have done in Blender's own process."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from blender_jobs.backend import ignore
from numpy.typing import NDArray
from synthetic_worlds import camera, flat_world, settings

from oaisys_core.errors import RenderError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.render.blender import BlenderBackend
from oaisys_core.types import ALBEDO, DEPTH, RGB

NODES = 120
"""Colours that a shader needs at the same time; a hundred are too many for Cycles."""

BLACK_XY_M = -15.0, 0.0
"""Where the ground of `black_texture` is black for some metres."""


def overflowing() -> tuple[list[str], str, list[NDArray[Any]]]:
    """Errors of renders with a shader that does not fit Cycles' stack, and what they print.

    The second error is that of the same scene rendered again, the third is without a standard
    error. The pictures are before and after.
    """
    backend = _backend()
    first = _picture(backend)
    bpy.context.scene.cycles.shading_system = False
    thing = _with_huge_material()
    with tempfile.TemporaryFile() as file, _as_standard_error(file.fileno()):
        errors = [_error(backend), _error(backend)]
        os.close(2)
        errors.append(_error(backend))
        file.seek(0)
        printed = file.read().decode()
    bpy.data.objects.remove(thing)
    return errors, printed, [first, _picture(backend)]


def black() -> dict[str, list[str]]:
    """Errors of renders of a ground with a colour, without one, and with one again, by kind."""
    kinds = {
        "denoised": (RGB, True, 0.7),
        "night": (RGB, False, -0.5),
        "albedo": (ALBEDO, False, 0.7),
    }
    return {kind: _black(*how) for kind, how in kinds.items()}


def black_texture() -> str:
    """The error of a render of a texture that is black where the camera looks, and nowhere else."""
    world = flat_world()
    (first, *others) = world.material.layers
    color = np.full((16, 16, 3), 200, np.uint8)
    color[:4, :] = color[-4:, :] = color[:, :4] = color[:, -4:] = 0
    maps = replace(first.maps, color_srgb=color, tile_m=40.0)
    layers = tuple(replace(each, maps=maps) for each in (first, *others))
    backend = BlenderBackend()
    backend.build(replace(world, material=replace(world.material, layers=layers)), ignore)
    view = camera(pose_looking_down(*BLACK_XY_M, 3), modalities=(RGB,))
    try:
        picture = backend.render_all([view], settings(), ignore)[0].data
    except RenderError as error:
        return str(error)
    return "" if picture.mean() < 1 else f"the picture is not black: {picture.mean()}"


def _black(modality: str, denoise: bool, elevation_rad: float) -> list[str]:
    backend = _backend(elevation_rad)
    (material,) = (each for each in bpy.data.materials if each.name == "ground")
    (output,) = (n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    (link,) = output.inputs["Surface"].links
    shader = link.from_socket
    errors = [_error(backend, modality, denoise)]
    material.node_tree.links.remove(link)
    errors.append(_error(backend, modality, denoise))
    material.node_tree.links.new(shader, output.inputs["Surface"])
    return [*errors, _error(backend, modality, denoise)]


def _backend(elevation_rad: float = 0.7) -> BlenderBackend:
    world = flat_world()
    sky = replace(world.sky, sun_elevation_rad=elevation_rad)
    backend = BlenderBackend()
    backend.build(replace(world, sky=sky), ignore)
    return backend


def _picture(backend: BlenderBackend) -> NDArray[Any]:
    view = camera(pose_looking_down(0, 0, 6), modalities=(RGB,))
    return np.array(backend.render_all([view], settings(), ignore)[0].data)


def _error(backend: BlenderBackend, modality: str = RGB, denoise: bool = False) -> str:
    view = camera(pose_looking_down(0, 0, 6), modalities=(DEPTH, modality))
    try:
        backend.render_all([view], replace(settings(), denoise=denoise), ignore)
    except RenderError as error:
        return str(error)
    return ""


def _with_huge_material() -> Any:
    """Add an object whose material needs many colours at the same time."""
    material = bpy.data.materials.new("huge")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    colors = []
    for index in range(NODES):
        noise = tree.nodes.new("ShaderNodeTexNoise")
        noise.inputs["Scale"].default_value = 1 + index
        colors.append(noise.outputs["Color"])
    total = colors[0]
    for color in colors[1:]:
        total = _vector_node(tree, "ADD", total, color)
    # Each colour is needed again after the sum of all.
    result = total
    for color in colors:
        result = _vector_node(tree, "MULTIPLY_ADD", color, total, result)
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(result, emission.inputs["Color"])
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    mesh = bpy.data.meshes.new("huge")
    mesh.from_pydata([(0, 0, 3), (1, 0, 3), (0, 1, 3)], [], [(0, 1, 2)])
    mesh.materials.append(material)
    thing = bpy.data.objects.new("huge", mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def _vector_node(tree: Any, operation: str, *values: Any) -> Any:
    node = tree.nodes.new("ShaderNodeVectorMath")
    node.operation = operation
    for value, socket in zip(values, node.inputs, strict=False):
        tree.links.new(value, socket)
    return node.outputs[0]


@contextmanager
def _as_standard_error(descriptor: int) -> Iterator[None]:
    """Use a file as standard error and as standard output, where Blender 5 logs."""
    kept = os.dup(1), os.dup(2)
    try:
        for number in (1, 2):
            os.dup2(descriptor, number)
        yield
    finally:
        for number, before in zip((1, 2), kept, strict=True):
            os.dup2(before, number)
            os.close(before)
