"""Meshes as PLY files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.mesh_formats.mesh_headers import check_map_file
from oaisys_core.files.whole_files import whole_file
from oaisys_mapping.mesh import ColoredMesh

HEADER_BYTES = 65_536
"""Bytes at the start of a file in which its header is searched."""

PLY_TYPES = {"<f4": "float", "u1": "uchar", "<u2": "ushort"}
"""PLY names of the numpy types that `write_ply` writes."""


def write_ply(path: Path, mesh: ColoredMesh, class_names: Mapping[int, str] | None = None) -> None:
    """Write a mesh, whole or not at all, as binary PLY with colours; inverse: `read_ply`.

    Coordinates are stored as float32. If the mesh has classes, vertices have the properties
    ``class_id`` (ushort) and ``class_probability`` (float), and comments ``class ID NAME`` give
    the classes' names.
    """
    columns = dict(zip("xyz", mesh.vertices_m.T, strict=True))
    columns |= dict(zip(("red", "green", "blue"), mesh.colors_rgb.T, strict=True))
    kinds = {"x": "<f4", "y": "<f4", "z": "<f4", "red": "u1", "green": "u1", "blue": "u1"}
    if mesh.class_ids is not None:
        columns["class_id"], kinds["class_id"] = mesh.class_ids, "<u2"
    if mesh.class_probabilities is not None:
        columns["class_probability"] = mesh.class_probabilities
        kinds["class_probability"] = "<f4"
    vertex = np.empty(len(mesh.vertices_m), list(kinds.items()))
    for name, values in columns.items():
        vertex[name] = values
    face = np.empty(len(mesh.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    face["count"] = 3
    face["corners"] = mesh.triangles
    comments = "".join(
        f"comment class {number} {' '.join(name.split())}\n"
        for number, name in sorted((class_names or {}).items())
    )
    properties = "".join(f"property {PLY_TYPES[kind]} {name}\n" for name, kind in kinds.items())
    header = (
        f"ply\nformat binary_little_endian 1.0\n{comments}"
        f"element vertex {len(vertex)}\n{properties}"
        f"element face {len(face)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    with whole_file(path) as partial:
        partial.write_bytes(header.encode("utf-8") + vertex.tobytes() + face.tobytes())


def read_ply(path: Path, field: str = "mesh") -> ColoredMesh:
    """Return the mesh in a PLY file, or in any mesh file that Open3D reads.

    Meshes without colours are grey. Classes are read from the vertex properties of `write_ply`.

    Args:
        path: The file.
        field: Name of the file in error messages.

    Raises:
        InvalidInputError: The file cannot be read, is truncated, or holds no valid triangles.
    """
    import open3d as o3d

    if not path.is_file():
        raise InvalidInputError(field, str(path), "an existing file")
    check_map_file(path, field)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(str(path))
    vertices_m = np.asarray(mesh.vertices, np.float64)
    triangles = np.asarray(mesh.triangles, np.int32)
    if not len(triangles):
        raise InvalidInputError(field, str(path), "a mesh file with triangles")
    if len(vertices_m) < _count_in_header(path, b"vertex") or len(triangles) < _count_in_header(
        path, b"face"
    ):
        raise InvalidInputError(field, str(path), "a complete file; this one is truncated")
    if not np.isfinite(vertices_m).all():
        raise InvalidInputError(field, str(path), "a mesh with finite coordinates")
    if triangles.min() < 0 or triangles.max() >= len(vertices_m):
        raise InvalidInputError(field, str(path), "triangles of vertices that are in the file")
    colors: NDArray[np.uint8] = np.full(vertices_m.shape, 128, np.uint8)
    if mesh.has_vertex_colors():
        colors = np.rint(np.asarray(mesh.vertex_colors) * 255).astype(np.uint8)
    classes = _vertex_properties(path, ("class_id", "class_probability"))
    return ColoredMesh(
        vertices_m, triangles, colors, classes.get("class_id"), classes.get("class_probability")
    )


def read_class_names(path: Path) -> dict[int, str]:
    """Return the names of classes by id in a PLY file; see `write_ply`."""
    found = re.findall(rb"\ncomment class (\d+) ([^\n]*)", _header(path))
    return {int(number): name.decode("utf-8") for number, name in found}


def _vertex_properties(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the vertex properties with these names, if a binary PLY file has them.

    Open3D ignores such properties.
    """
    header = _header(path)
    element = re.search(rb"\nelement vertex (\d+)\n((?:property \w+ \w+\n)*)", header)
    if element is None or header.find(b"\nelement ") != element.start():
        return {}
    if not header.startswith(b"ply\nformat binary_little_endian"):
        return {}
    kinds = {ply.encode(): kind for kind, ply in PLY_TYPES.items()}
    found = [line.split()[1:] for line in element[2].splitlines()]
    if any(kind not in kinds for kind, _ in found):
        return {}
    row = np.dtype([(name.decode(), kinds[kind]) for kind, name in found])
    wanted = [name for name in names if name in (row.names or ())]
    if not wanted:
        return {}
    vertex = np.fromfile(path, row, int(element[1]), offset=len(header))
    return {name: np.ascontiguousarray(vertex[name]) for name in wanted}


def _header(path: Path) -> bytes:
    """Return a file's header including its last line."""
    with path.open("rb") as file:
        content = file.read(HEADER_BYTES)
    end = b"end_header\n"
    return content[: content.find(end) + len(end)] if end in content else b""


def _count_in_header(path: Path, element: bytes) -> int:
    """Return the number of an element that a PLY file's header announces; 0 for other files.

    Open3D returns a part of a truncated file without an error.
    """
    header = _header(path)
    found = re.search(rb"\belement " + element + rb" (\d+)", header)
    return int(found[1]) if header.startswith(b"ply") and found else 0
