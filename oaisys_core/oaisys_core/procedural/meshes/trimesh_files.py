"""Meshes of .ply and .stl files, read with trimesh."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.mesh_formats.mesh_headers import (
    MAX_HEADER_BYTES,
    MAX_VERTICES,
    is_text_ply,
    is_text_stl,
)
from oaisys_core.procedural.meshes.checks import float32_step
from oaisys_core.procedural.meshes.loaded import LoadedMesh, decode_texture
from oaisys_core.procedural.meshes.obj_format.obj_statements import file_name
from oaisys_core.procedural.meshes.ply_elements import (
    has_float_vertices,
    ply_colors,
    ply_image_of,
    ply_mesh,
    ply_uv,
)
from oaisys_core.procedural.meshes.references import FileReferences, check_texture
from oaisys_core.scene import MeshMaterial

LOG = logging.getLogger(__name__)

FLOAT_COORDINATE = re.compile(rb"(?m)^([ \t]*property[ \t]+)float(?:16|32)?([ \t]+[xyz][ \t\r]*)$")
"""Line of a .ply file's header."""

WHITE, GREY = (1.0, 1.0, 1.0), (0.5, 0.5, 0.5)
"""What is multiplied by an image, and what its faces are without it."""


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
    references = FileReferences(path, field)
    scene = _load_scene(path, references, field)
    count = sum(
        len(getattr(scene.geometry[scene.graph[node][1]], "faces", ()))
        for node in scene.graph.nodes_geometry
    )
    if count > MAX_VERTICES:
        raise InvalidInputError(field, str(path), f"at most {MAX_VERTICES} triangles, not {count}")
    try:
        found = list(_parts(scene, path, references))
        references.tell_missing()
        if path.suffix.lower() == ".stl":
            _check_facets(path, count)
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise InvalidInputError(field, str(path), f"a {path.suffix} file of {error}") from error
    if object_name is None:
        return [part for _, part in found]
    chosen = [part for name, part in found if object_name == name]
    return chosen or sorted({name for name, _ in found})


def _load_scene(path: Path, references: FileReferences, field: str) -> Any:
    """Return what trimesh reads from a file, without the images of a .ply file."""
    import trimesh

    suffix = path.suffix.lower()[1:]
    own = {"skip_materials": True} if suffix == "ply" else {}
    try:
        with _content(path) as file:
            scene = trimesh.load_scene(
                file, file_type=suffix, resolver=references, process=False, **own
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


def _content(path: Path) -> BinaryIO:
    """Open a file; in a .ply file of text, coordinates of float are announced as double.

    The digits are there, and trimesh would round them to what the header says.
    """
    if not is_text_ply(path):
        return path.open("rb")
    header, end, rest = path.read_bytes().partition(b"\nend_header")
    return io.BytesIO(FLOAT_COORDINATE.sub(rb"\1double\2", header) + end + rest)


def _parts(scene: Any, path: Path, references: FileReferences) -> Sequence[tuple[str, LoadedMesh]]:
    """Return the objects of a file, with their names."""
    import trimesh

    parts: list[tuple[str, LoadedMesh]] = []
    for node in scene.graph.nodes_geometry:
        T, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if isinstance(mesh, trimesh.Trimesh):
            elements, name = mesh.metadata.get("_ply_raw"), str(node)
            if elements is None:
                part = _bare(name, mesh.copy().apply_transform(T))
                is_coarse = path.suffix.lower() == ".stl" and not is_text_stl(path)
            else:
                part = _of_ply(name, elements, path, references)
                is_coarse = has_float_vertices(elements)
            if is_coarse:
                part = replace(part, float32=float32_step(part.vertices_m, part.triangles))
            parts.append((name, part))
    return parts


def _bare(name: str, mesh: Any) -> LoadedMesh:
    return LoadedMesh(name, np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))


def _of_ply(
    name: str, elements: Mapping[str, Any], path: Path, references: FileReferences
) -> LoadedMesh:
    """Return the mesh of a .ply file, with its images, or else with its colours."""
    own = ply_mesh(elements)
    files = texture_files(path)
    uv = ply_uv(elements, own) if files else None
    if files and uv is None:
        LOG.warning("%s: its TextureFile is not used, as it has no texture coordinates", path)
    if uv is not None:
        which = ply_image_of(elements, own, len(files))
        images = [_image(references, file) for file in files]
        if any(image is not None for image in images):
            materials = tuple(
                MeshMaterial(f"{name}_{index}", GREY if image is None else WHITE, image)
                for index, image in enumerate(images)
            )
            if len(materials) == 1:
                materials = (replace(materials[0], name=name),)
            return LoadedMesh(
                name, own.vertices, own.triangles, uv, materials=materials, material_of=which
            )
    colors = ply_colors(elements, own)
    return LoadedMesh(name, own.vertices, own.triangles, vertex_colors_srgb=colors)


def texture_files(path: Path) -> list[str]:
    """Return the names behind ``comment TextureFile`` in a .ply file, whose order counts."""
    with path.open("rb") as file:
        header = file.read(MAX_HEADER_BYTES).partition(b"\nend_header")[0]
    names = re.findall(rb"(?mi)^[ \t]*comment[ \t]+TextureFile[ \t]+(\S.*?)[ \t\r]*$", header)
    return [file_name(name) for name in names]


def _image(references: FileReferences, name: str) -> NDArray[np.uint8] | None:
    """Return the (H, W, 3) pixels of an image; None: it is not there."""
    data = references.find(name)
    if data is None:
        return None
    check_texture(data, name)
    return decode_texture(data, name)[0]


def _check_facets(path: Path, count: int) -> None:
    """Raise if trimesh left out facets of a text, as of solids that are called `vertex`."""
    if is_text_stl(path):
        facets = len(re.findall(rb"(?im)^[ \t]*facet\b", path.read_bytes()))
        if facets != count:
            raise ValueError(f"{facets} facets that can be read, not {count}: rename its solids")
