"""Reading user meshes from files of others: see docs/files.md for what is read of each format."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.mesh_formats.mesh_headers import check_mesh_file
from oaisys_core.procedural.meshes.blender_files import BLENDER_SUFFIXES, load_by_blender
from oaisys_core.procedural.meshes.checks import check_mesh, check_uv
from oaisys_core.procedural.meshes.gltf_format.gltf import load_gltf
from oaisys_core.procedural.meshes.loaded import LoadedMesh, merge_parts, without_unused
from oaisys_core.procedural.meshes.obj_format.obj import load_obj
from oaisys_core.procedural.meshes.trimesh_files import load_by_trimesh
from oaisys_core.types import FloatArray

SUFFIXES = (".obj", ".glb", ".gltf", ".ply", ".stl", *BLENDER_SUFFIXES)
Y_UP_SUFFIXES = (".glb", ".gltf")
"""Formats with y up by their standard, which are rotated to z up. COLLADA and USD say which axis
points up; others are left as they are."""

CONVERTED = (".fbx", ".3ds", ".x3d", ".wrl", ".abc", ".3mf", ".step", ".stp", ".iges", ".off")
"""Formats that people have and nothing here reads."""

R_Z_UP_FROM_Y_UP: FloatArray = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def load_mesh(path: Path, object_name: str | None = None, field: str = "file") -> LoadedMesh:
    """Return the mesh of a file, or of one object in it; several objects are merged.

    Vertices that no triangle has are left out.

    A separate process reads .blend, .dae and USD files by Blender, without running scripts in them.

    Args:
        path: The file.
        object_name: Name of the object; None for all objects.
        field: Name of the file's field in errors.

    Raises:
        InvalidInputError: The file cannot be read, has no such object or no triangles, or cannot
            be rendered, see `check_mesh`.
        BackendUnavailableError: Blender reads it and ``bpy`` is not installed.
    """
    _check_name(path, field)
    if path.suffix.lower() in BLENDER_SUFFIXES:
        found = load_by_blender(path, object_name, field)
        if not isinstance(found, LoadedMesh):
            raise _no_such_object(field, object_name or "", found)
        return without_unused(found)
    check_mesh_file(path, field)
    turned = path.suffix.lower() in Y_UP_SUFFIXES
    read = load_gltf if turned else load_by_trimesh
    if path.suffix.lower() == ".obj":
        read = load_obj
    content = read(path, object_name, field)
    parts = [part for part in content if isinstance(part, LoadedMesh) and len(part.triangles)]
    if object_name is not None and not parts:
        names = [name for name in content if isinstance(name, str)]
        raise _no_such_object(field, object_name, names)
    if not parts:
        raise InvalidInputError(field, str(path), "a file with at least one triangle")
    for part in parts:
        check_mesh(np.asarray(part.vertices_m, np.float64), part.triangles, path, field)
    check_uv((part.uv for part in parts), path, field)
    mesh = merge_parts(object_name or path.stem, parts, field)
    if turned:
        mesh = replace(mesh, vertices_m=mesh.vertices_m @ R_Z_UP_FROM_Y_UP.T)
    return without_unused(mesh)


def _check_name(path: Path, field: str) -> None:
    """Raise on files that are not there, or of another format."""
    if path.suffix.lower() not in SUFFIXES:
        expected = f"a file that ends in {', '.join(SUFFIXES)}"
        if path.suffix.lower() in CONVERTED:
            expected += " (Blender opens it and exports .glb, which keeps its textures)"
        raise InvalidInputError(field, str(path), expected)
    if not path.is_file():
        raise InvalidInputError(field, str(path), "an existing file")


def _no_such_object(field: str, name: str, names: Iterable[str]) -> InvalidInputError:
    known = ", ".join(sorted(names)) or "no object has triangles"
    return InvalidInputError(f"{field} object", name, f"an object with triangles: {known}")
