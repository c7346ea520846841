"""A mesh as glTF whose colours are shown as they are, whatever light a page has."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.gltf import export_glb

from oaisys_core.color import linear
from oaisys_mapping.mesh import ColoredMesh

UNLIT = "KHR_materials_unlit"
"""glTF's extension for surfaces that are shown in their own colours."""


def unlit_glb(mesh: ColoredMesh) -> bytes:
    """Return a mesh as glTF binary that is shown in its own colours: they have been lit already."""
    # glTF's colours of vertices are linear.
    colors = np.rint(255 * linear(mesh.colors_rgb / 255.0)).astype(np.uint8)
    solid = trimesh.Trimesh(mesh.vertices_m, mesh.triangles, vertex_colors=colors, process=False)
    return bytes(export_glb(solid, tree_postprocessor=_without_light))


def _without_light(gltf: dict[str, Any]) -> None:
    """Give all meshes of a glTF file one material that no lamp changes, in place."""
    gltf["extensionsUsed"] = [UNLIT]
    gltf["materials"] = [{"extensions": {UNLIT: {}}}]
    for mesh in gltf["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
