"""Meshes into Blender, and back out as it will render them."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import ArrayLike

from oaisys_core.types import FloatArray, TriangleMesh


def new_mesh(name: str, vertices_m: ArrayLike, triangles: ArrayLike, *, smooth: bool) -> Any:
    """Return a Blender mesh of (V, 3) vertices and (T, 3) triangles."""
    vertices = np.ascontiguousarray(vertices_m, dtype=np.float32)
    corners = np.ascontiguousarray(triangles, dtype=np.int32)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    # Attributes take arrays as they are, Blender's other collections value by value.
    mesh.attributes["position"].data.foreach_set("vector", vertices.ravel())
    mesh.loops.add(corners.size)
    mesh.attributes[".corner_vert"].data.foreach_set("value", corners.ravel())
    mesh.polygons.add(len(corners))
    mesh.polygons.foreach_set("loop_start", np.arange(0, corners.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    if smooth:
        mesh.shade_smooth()
    else:
        mesh.shade_flat()
    return mesh


def new_object(name: str, mesh: Any, T_map_object: FloatArray) -> Any:
    """Return an object in the scene that shows ``mesh`` at a (4, 4) pose, which may scale."""
    thing = bpy.data.objects.new(name, mesh)
    thing.matrix_world = Matrix(T_map_object)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def evaluated_mesh(thing: Any) -> TriangleMesh:
    """Return an object's triangles, which all its faces are, in its own frame, as rendered."""
    mesh = thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    vertices = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.attributes["position"].data.foreach_get("vector", vertices)
    corners = np.empty(len(mesh.polygons) * 3, dtype=np.int32)
    mesh.attributes[".corner_vert"].data.foreach_get("value", corners)
    return TriangleMesh(vertices.reshape(-1, 3).astype(np.float64), corners.reshape(-1, 3))
