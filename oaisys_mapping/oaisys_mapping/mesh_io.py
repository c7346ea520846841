"""Meshes as PLY files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import TriangleMesh
from oaisys_mapping.mesh import ColoredMesh

HEADER_BYTES = 8192
"""How far into a file its header is looked for."""


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


def read_ply(path: Path, field: str = "mesh") -> ColoredMesh:
    """Return the mesh in a PLY file, or in any mesh file that Open3D reads; grey without colours.

    Args:
        path: The file.
        field: What an error calls it.

    Raises:
        InvalidInputError: It cannot be read, is cut off, or holds no valid triangles.
    """
    if not path.is_file():
        raise InvalidInputError(field, str(path), "an existing file")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(str(path))
    vertices_m = np.asarray(mesh.vertices, np.float64)
    triangles = np.asarray(mesh.triangles, np.int32)
    if not len(triangles):
        raise InvalidInputError(field, str(path), "a mesh file with triangles")
    if len(vertices_m) < _promised(path, b"vertex") or len(triangles) < _promised(path, b"face"):
        raise InvalidInputError(field, str(path), "a whole file; this one ends too early")
    if not np.isfinite(vertices_m).all():
        raise InvalidInputError(field, str(path), "a mesh with finite coordinates")
    if triangles.min() < 0 or triangles.max() >= len(vertices_m):
        raise InvalidInputError(field, str(path), "triangles of vertices that are in the file")
    colors: NDArray[np.uint8] = np.full(vertices_m.shape, 128, np.uint8)
    if mesh.has_vertex_colors():
        colors = np.rint(np.asarray(mesh.vertex_colors) * 255).astype(np.uint8)
    return ColoredMesh(vertices_m, triangles, colors)


def _promised(path: Path, element: bytes) -> int:
    """Return how many of an element a PLY file's header announces; 0 for other files.

    Open3D returns what it found of a file that is cut off.
    """
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES).split(b"end_header")[0]
    found = re.search(rb"\belement " + element + rb" (\d+)", header)
    return int(found[1]) if header.startswith(b"ply") and found else 0


def write_truth(path: Path, truth: TriangleMesh) -> None:
    """Write a true mesh, without ids, as binary PLY."""
    grey = np.full((len(truth.vertices_m), 3), 128, np.uint8)
    write_ply(path, ColoredMesh(truth.vertices_m, truth.triangles, grey))


def read_truth(path: Path) -> TriangleMesh:
    """Return the true mesh in a file.

    Raises:
        InvalidInputError: It cannot be read or holds no triangles.
    """
    mesh = read_ply(path, "truth")
    return TriangleMesh(mesh.vertices_m, mesh.triangles)
