"""True meshes as PLY files with labels per triangle."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.mesh_formats.mesh_headers import check_map_file
from oaisys_core.files.whole_files import whole_file
from oaisys_core.types import TriangleMesh
from oaisys_mapping.mesh_io import read_ply

HEADER_BYTES = 4096
"""Bytes at the start of a file in which its header is searched."""

VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
FACE = np.dtype(
    [("count", "u1"), ("corners", "<i4", 3), ("semantic_id", "<u2"), ("instance_id", "<u4")]
)


def header_of(vertices: int, faces: int) -> bytes:
    """Return the header of a file with these numbers of elements."""
    return (
        "ply\nformat binary_little_endian 1.0\ncomment oaisys true surface, metres in map\n"
        f"element vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {faces}\nproperty list uchar int vertex_indices\n"
        "property ushort semantic_id\nproperty uint instance_id\nend_header\n"
    ).encode("ascii")


def as_stored(truth: TriangleMesh) -> TriangleMesh:
    """Return a true mesh with its coordinates rounded to float32, as in a file."""
    rounded_m = truth.vertices_m.astype(np.float32).astype(np.float64)
    return TriangleMesh(rounded_m, truth.triangles, truth.semantic_ids, truth.instance_ids)


def write_truth(path: Path, truth: TriangleMesh) -> None:
    """Write a true mesh as binary PLY, with ids as face properties; inverse: `read_truth`."""
    vertex = np.empty(len(truth.vertices_m), VERTEX)
    for axis, name in enumerate("xyz"):
        vertex[name] = truth.vertices_m[:, axis]
    face = np.empty(len(truth.triangles), FACE)
    face["count"], face["corners"] = 3, truth.triangles
    face["semantic_id"] = 0 if truth.semantic_ids is None else truth.semantic_ids
    face["instance_id"] = 0 if truth.instance_ids is None else truth.instance_ids
    with whole_file(path) as part, part.open("wb") as file:
        file.write(header_of(len(vertex), len(face)))
        file.write(vertex.data)
        file.write(face.data)


def read_truth(path: Path) -> TriangleMesh:
    """Return the true mesh in a file; files of other programs have no ids.

    Raises:
        InvalidInputError: The file cannot be read, is truncated or holds no valid triangles.
    """
    if not path.is_file():
        raise InvalidInputError("truth", str(path), "an existing file")
    check_map_file(path, "truth")
    with path.open("rb") as file:
        start = file.read(HEADER_BYTES)
        found = re.search(rb"element vertex (\d+)\n.*element face (\d+)\n", start, re.DOTALL)
        counts = (int(found[1]), int(found[2])) if found else (0, 0)
        if not (all(counts) and start.startswith(header_of(*counts))):
            mesh = read_ply(path, "truth")
            return TriangleMesh(mesh.vertices_m, mesh.triangles)
        file.seek(len(header_of(*counts)))
        vertex = np.fromfile(file, VERTEX, counts[0])
        face = np.fromfile(file, FACE, counts[1])
    if len(face) < counts[1]:
        raise InvalidInputError("truth", str(path), "a complete file; this one is truncated")
    vertices_m = np.column_stack([vertex[axis] for axis in "xyz"]).astype(np.float64)
    triangles = np.ascontiguousarray(face["corners"])
    if not np.isfinite(vertices_m).all():
        raise InvalidInputError("truth", str(path), "a mesh with finite coordinates")
    if triangles.min() < 0 or triangles.max() >= len(vertices_m):
        raise InvalidInputError("truth", str(path), "triangles of vertices that are in the file")
    ids = (face["semantic_id"].copy(), face["instance_id"].copy())
    return TriangleMesh(vertices_m, triangles, *ids)
