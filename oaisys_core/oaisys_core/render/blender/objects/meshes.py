"""Blender meshes from arrays, and arrays from Blender meshes."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import ArrayLike, NDArray

from oaisys_core.procedural.terrain.detail import DetailedGround
from oaisys_core.scene import Ground, HeightField
from oaisys_core.types import FloatArray, TriangleMesh

NAME = "ground"

NORMALS = "custom_normal"
"""Attribute with the normals of vertices that Blender shades with instead of those of the mesh."""

Corners = NDArray[np.int32]


def new_mesh(name: str, vertices_m: ArrayLike, triangles: ArrayLike, *, smooth: bool) -> Any:
    """Return a Blender mesh of (V, 3) vertices and (T, 3) triangles."""
    vertices = np.ascontiguousarray(vertices_m, dtype=np.float32)
    corners = np.ascontiguousarray(triangles, dtype=np.int32)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    # Attributes are copied as a whole, Blender's other collections value by value.
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
    """Add an object to the scene that shows ``mesh`` at a (4, 4) pose, which may scale it."""
    thing = bpy.data.objects.new(name, mesh)
    thing.matrix_world = Matrix(T_map_object)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def triangles_of(mesh: Any) -> TriangleMesh:
    """Return the faces of a mesh without modifiers, all of which are triangles, in its own frame.

    Reading an attribute makes it an array of its own, so the mesh is read itself, not the copy of
    it that is rendered, and before there is one: both share their arrays.
    """
    vertices = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.attributes["position"].data.foreach_get("vector", vertices)
    corners = np.empty(len(mesh.polygons) * 3, dtype=np.int32)
    mesh.attributes[".corner_vert"].data.foreach_get("value", corners)
    return TriangleMesh(vertices.reshape(-1, 3).astype(np.float64), corners.reshape(-1, 3))


class GroundMeshes:
    """Makes the meshes of successive grounds.

    Grids of the same size differ only in their vertices, so each is a copy of the one before, with
    which it shares its topology in Blender's memory.
    """

    def __init__(self) -> None:
        self._last: Any = None
        self._shape: tuple[int, ...] | None = None

    def make(self, ground: Ground) -> Any:
        """Return a smoothly shaded mesh of a ground, without materials."""
        before, shape = self._last, self._shape
        self._shape = ground.elevation_m.shape if isinstance(ground, HeightField) else None
        if self._shape is None:
            self._last = new_mesh(NAME, ground.vertices_m(), ground.triangles(), smooth=True)
            normals = ground.shading_normals() if isinstance(ground, DetailedGround) else None
            if normals is not None:
                self._last.attributes.new(NORMALS, "FLOAT_VECTOR", "POINT")
                _set(self._last, NORMALS, "vector", normals)
        else:
            self._last = before.copy() if self._shape == shape else _grid_mesh(ground, self._shape)
            self._last.materials.clear()
            _set(self._last, "position", "vector", ground.vertices_m())
            self._last.update()
        # Keeps the mesh after its object was removed, so that the next one can be a copy.
        self._last.use_fake_user = True
        if before is not None:
            before.use_fake_user = False
        return self._last


def _grid_mesh(ground: Ground, shape: tuple[int, ...]) -> Any:
    """Return a mesh with the topology of a grid and uninitialised vertices."""
    rows, cols = shape
    triangles = ground.triangles()
    edges, edge_of_corner = _edges(rows, cols)
    mesh = bpy.data.meshes.new(NAME)
    mesh.vertices.add(rows * cols)
    mesh.edges.add(len(edges))
    mesh.loops.add(triangles.size)
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    _set(mesh, ".edge_verts", "value", edges)
    _set(mesh, ".corner_vert", "value", triangles)
    _set(mesh, ".corner_edge", "value", edge_of_corner)
    mesh.shade_smooth()
    return mesh


def _edges(rows: int, cols: int) -> tuple[Corners, Corners]:
    """Return the (E, 2) edges of a grid's triangles, and (T, 3) the edge after each corner.

    Computed, because Blender's search for edges is slow. Edges are ordered: along x, along y,
    diagonals of the cells.
    """
    point = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    along_x = np.arange(rows * (cols - 1), dtype=np.int32).reshape(rows, cols - 1)
    along_y = along_x.size + np.arange((rows - 1) * cols, dtype=np.int32).reshape(rows - 1, cols)
    cells = (rows - 1, cols - 1)
    first_diagonal = along_x.size + along_y.size
    diagonal = first_diagonal + np.arange(cells[0] * cells[1], dtype=np.int32).reshape(cells)
    edges = np.empty((first_diagonal + diagonal.size, 2), np.int32)
    for numbers, start, end in (
        (along_x, point[:, :-1], point[:, 1:]),
        (along_y, point[:-1], point[1:]),
        (diagonal, point[:-1, :-1], point[1:, 1:]),
    ):
        part = edges[numbers[0, 0] : numbers[-1, -1] + 1]
        part[:, 0], part[:, 1] = start.ravel(), end.ravel()
    of_corner = np.empty((*cells, 6), np.int32)
    sides = (along_x[:-1], along_y[:, 1:], diagonal, diagonal, along_x[1:], along_y[:, :-1])
    for index, side in enumerate(sides):
        of_corner[..., index] = side
    return edges, of_corner.reshape(-1, 3)


def _set(mesh: Any, attribute: str, field: str, values: NDArray[Any]) -> None:
    """Copy values into an attribute."""
    mesh.attributes[attribute].data.foreach_set(field, values.ravel())
