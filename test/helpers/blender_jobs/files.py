"""What the tests of mesh files do inside Blender."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import bpy
import numpy as np

from oaisys_core.backend.blender.objects.meshes import new_mesh, new_object
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata


def save_blend(path: str, script_writes: str) -> None:
    """Save a file with two pyramids, one of them modified and moved, and a script that writes."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)]
    triangles = [(0, 2, 1), (0, 3, 2), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    for name in ("small", "tall"):
        mesh = new_mesh(name, vertices, triangles, smooth=False)
        material = bpy.data.materials.new(name)
        if material.node_tree is None:
            material.use_nodes = True
        shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        shader.inputs["Base Color"].default_value = (1.0, 0.0, 0.0, 1.0)
        mesh.materials.append(material)
        thing = new_object(name, mesh, np.eye(4))
        if name == "tall":
            thing.location, thing.scale = (10.0, 0.0, 0.0), (1.0, 1.0, 3.0)
            thing.modifiers.new("array", "ARRAY").count = 2
    text = bpy.data.texts.new("attack.py")
    text.write(f"open({script_writes!r}, 'w')")
    text.use_module = True
    bpy.ops.wm.save_as_mainfile(filepath=path)


def refused_stage(config: Mapping[str, Any], metadata: ModuleMetadata) -> str:
    """What a batch with the metadata is refused for; empty: it is not."""
    simulation = Simulation(config_from_mapping(config))
    try:
        simulation.step_batch(metadata)
    except InvalidInputError as error:
        return str(error)
    return ""
