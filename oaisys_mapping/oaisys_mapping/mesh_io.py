"""Meshes as PLY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import TriangleMesh
from oaisys_mapping.mesh import ColoredMesh


def write_ply(path: Path, mesh: ColoredMesh) -> None:
    """Write a mesh as binary PLY with a colour per vertex; inverse: `read_ply`.

    Coordinates are stored as float32.
    """
    vertex = np.empty(
        len(mesh.vertices_m),
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")],
    )
    for axis, name in enumerate(("x", "y", "z")):
        vertex[name] = mesh.vertices_m[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertex[name] = mesh.colors_rgb[:, channel]
    face = np.empty(len(mesh.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    face["count"] = 3
    face["corners"] = mesh.triangles
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertex)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        f"element face {len(face)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode("ascii") + vertex.tobytes() + face.tobytes())


def read_ply(path: Path) -> ColoredMesh:
    """Return the mesh in a PLY file, or in any mesh file that Open3D reads; grey without colours.

    Raises:
        InvalidInputError: It cannot be read or holds no triangles.
    """
    if not path.is_file():
        raise InvalidInputError("mesh", str(path), "an existing file")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(str(path))
    if not mesh.has_triangles():
        raise InvalidInputError("mesh", str(path), "a mesh file with triangles")
    vertices_m = np.asarray(mesh.vertices, np.float64)
    colors: NDArray[np.uint8] = np.full(vertices_m.shape, 128, np.uint8)
    if mesh.has_vertex_colors():
        colors = np.rint(np.asarray(mesh.vertex_colors) * 255).astype(np.uint8)
    return ColoredMesh(vertices_m, np.asarray(mesh.triangles, np.int32), colors)


def write_truth(path: Path, truth: TriangleMesh) -> None:
    """Write a true mesh, without ids, as binary PLY."""
    grey = np.full((len(truth.vertices_m), 3), 128, np.uint8)
    write_ply(path, ColoredMesh(truth.vertices_m, truth.triangles, grey))


def read_truth(path: Path) -> TriangleMesh:
    """Return the true mesh in a file.

    Raises:
        InvalidInputError: It cannot be read or holds no triangles.
    """
    mesh = read_ply(path)
    return TriangleMesh(mesh.vertices_m, mesh.triangles)
