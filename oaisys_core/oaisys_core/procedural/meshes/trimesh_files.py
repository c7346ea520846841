"""Meshes of .ply and .stl files, read with trimesh."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.images import MESH_TEXTURE
from oaisys_core.files.mesh_headers import MAX_VERTICES, is_text_stl
from oaisys_core.procedural.meshes.loaded import LoadedMesh, split_image
from oaisys_core.procedural.meshes.ply_elements import ply_colors, ply_mesh
from oaisys_core.procedural.meshes.references import FileReferences
from oaisys_core.scene import MeshMaterial


def load_by_trimesh(
    path: Path, object_name: str | None, field: str
) -> list[LoadedMesh] | list[str]:
    """Return the parts of a file, or of one object in it, whose size has been checked.

    Args:
        path: The file.
        object_name: Name of the object; None for all objects.
        field: Name of the file's field in errors.

    Returns:
        The parts; or the names of all objects, if none has that name.

    Raises:
        InvalidInputError: It cannot be read, or refers to a file elsewhere.
    """
    scene = _load_scene(path, field)
    count = sum(
        len(getattr(scene.geometry[scene.graph[node][1]], "faces", ()))
        for node in scene.graph.nodes_geometry
    )
    if count > MAX_VERTICES:
        raise InvalidInputError(field, str(path), f"at most {MAX_VERTICES} triangles, not {count}")
    try:
        found = list(_parts(scene))
        if path.suffix.lower() == ".stl":
            _check_facets(path, count)
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise InvalidInputError(field, str(path), f"a {path.suffix} file of {error}") from error
    if object_name is None:
        return [part for _, part in found]
    chosen = [part for name, part in found if object_name == name]
    return chosen or sorted({name for name, _ in found})


def _load_scene(path: Path, field: str) -> Any:
    """Return what trimesh reads from a file, and from others beside it."""
    import trimesh

    references = FileReferences(path, field)
    try:
        with path.open("rb") as file:
            scene = trimesh.load_scene(
                file, file_type=path.suffix.lower()[1:], resolver=references, process=False
            )
    # The exception that trimesh raises depends on the format.
    except Exception as error:
        if references.refused is not None:
            raise references.refused from error
        expected = f"a readable {path.suffix} file ({error})"
        raise InvalidInputError(field, str(path), expected) from error
    if references.refused is not None:
        raise references.refused
    return scene


def _parts(scene: Any) -> Sequence[tuple[str, LoadedMesh]]:
    """Return the objects of a file, with their names."""
    import trimesh

    parts: list[tuple[str, LoadedMesh]] = []
    for node in scene.graph.nodes_geometry:
        T, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if isinstance(mesh, trimesh.Trimesh):
            elements, name = mesh.metadata.get("_ply_raw"), str(node)
            if elements is None:
                parts.append((name, _bare(name, mesh.copy().apply_transform(T))))
            else:
                parts.append((name, _of_ply(name, mesh, elements)))
    return parts


def _bare(name: str, mesh: Any) -> LoadedMesh:
    return LoadedMesh(name, np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))


def _of_ply(name: str, mesh: Any, elements: Mapping[str, Any]) -> LoadedMesh:
    """Return the mesh of a .ply file: its own elements, unless it has an image."""
    own = ply_mesh(elements)
    uv = getattr(mesh.visual, "uv", None)
    image = getattr(getattr(mesh.visual, "material", None), "image", None)
    # Without a file trimesh makes up an image, which has no format.
    if image is None or image.format is None or uv is None:
        colors = ply_colors(elements, own)
        return LoadedMesh(name, own.vertices, own.triangles, vertex_colors_srgb=colors)
    if own.concave is not None:
        raise ValueError(f"a texture on convex faces: face {own.concave} is not (triangulate it)")
    width, height = image.size
    MESH_TEXTURE.check(width, height, "a mesh's texture")
    material = MeshMaterial(name, color_image_srgb=split_image(image)[0])
    bare = _bare(name, mesh)
    at = np.asarray(uv, np.float64).astype(np.float32)[bare.triangles]
    return LoadedMesh(name, bare.vertices_m, bare.triangles, at, materials=(material,))


def _check_facets(path: Path, count: int) -> None:
    """Raise if trimesh left out facets of a text, as of solids that are called `vertex`."""
    if is_text_stl(path):
        facets = len(re.findall(rb"(?im)^[ \t]*facet\b", path.read_bytes()))
        if facets != count:
            raise ValueError(f"{facets} facets that can be read, not {count}: rename its solids")
