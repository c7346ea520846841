"""Meshes of .obj, .ply and .stl files, read with trimesh."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.images import MESH_TEXTURE
from oaisys_core.files.mesh_headers import MAX_VERTICES
from oaisys_core.procedural.meshes.loaded import LoadedMesh, split_image
from oaisys_core.procedural.meshes.obj_materials import ObjMaterials, add_library_line
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
    references = FileReferences(path, field)
    materials = ObjMaterials(path, references) if path.suffix.lower() == ".obj" else None
    scene = _load_scene(path, field, references, materials)
    count = sum(
        len(getattr(scene.geometry[scene.graph[node][1]], "faces", ()))
        for node in scene.graph.nodes_geometry
    )
    if count > MAX_VERTICES:
        raise InvalidInputError(field, str(path), f"at most {MAX_VERTICES} triangles, not {count}")
    found = list(_parts(scene, path.stem, materials))
    if references.refused is not None:
        raise references.refused
    if object_name is None:
        return [part for _, part in found]
    chosen = [part for names, part in found if object_name in names]
    return chosen or sorted({names[0] for names, _ in found})


def _load_scene(
    path: Path, field: str, references: FileReferences, materials: ObjMaterials | None
) -> Any:
    """Return what trimesh reads from a file, and from others beside it."""
    import trimesh

    more: dict[str, Any] = {} if materials is None else {"split_objects": True}
    try:
        with path.open("rb") as file:
            scene = trimesh.load_scene(
                file if materials is None else add_library_line(file.read()),
                file_type=path.suffix.lower()[1:],
                resolver=references if materials is None else materials,
                process=False,
                **more,
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


def _parts(
    scene: Any, stem: str, materials: ObjMaterials | None
) -> Sequence[tuple[tuple[str, ...], LoadedMesh]]:
    """Return the objects of a file, with the names by which each can be chosen."""
    import trimesh

    parts: list[tuple[tuple[str, ...], LoadedMesh]] = []
    for node in scene.graph.nodes_geometry:
        T, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        mesh = mesh.copy().apply_transform(T)
        if materials is None:
            parts.append(((str(node),), _with_image(str(node), mesh)))
            continue
        material = getattr(getattr(mesh.visual, "material", None), "name", None)
        own = str(node).removesuffix(f"_{material}")
        names = (own, str(node), str(material or stem))
        parts.append((names, _with_obj_material(own, mesh, material, materials)))
    return parts


def _bare(name: str, mesh: Any) -> LoadedMesh:
    return LoadedMesh(name, np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))


def _uv(mesh: Any) -> Any:
    uv = getattr(mesh.visual, "uv", None)
    return None if uv is None else np.asarray(uv, np.float64)


def _with_vertex_colors(bare: LoadedMesh, mesh: Any) -> LoadedMesh:
    """Return a mesh with the vertex colours that its file has, if any."""
    if mesh.visual.kind not in ("vertex", "face"):
        return bare
    colors = np.array(mesh.visual.vertex_colors[:, :3], np.uint8)
    return LoadedMesh(bare.name, bare.vertices_m, bare.triangles, vertex_colors_srgb=colors)


def _with_image(name: str, mesh: Any) -> LoadedMesh:
    bare, uv = _bare(name, mesh), _uv(mesh)
    image = getattr(getattr(mesh.visual, "material", None), "image", None)
    if image is None or uv is None:
        return _with_vertex_colors(bare, mesh)
    width, height = image.size
    MESH_TEXTURE.check(width, height, "a mesh's texture")
    material = MeshMaterial(name, color_image_srgb=split_image(image)[0])
    at = uv.astype(np.float32)[bare.triangles]
    return LoadedMesh(name, bare.vertices_m, bare.triangles, at, materials=(material,))


def _with_obj_material(
    name: str, mesh: Any, material: str | None, materials: ObjMaterials
) -> LoadedMesh:
    bare = _bare(name, mesh)
    found = materials.of(material)
    if found is None:
        return _with_vertex_colors(bare, mesh)
    uv = _uv(mesh)
    if uv is None:
        plain = MeshMaterial(found.material.name, found.material.color_srgb)
        return LoadedMesh(name, bare.vertices_m, bare.triangles, materials=(plain,))
    at = (uv * found.scale + found.offset).astype(np.float32)[bare.triangles]
    return LoadedMesh(name, bare.vertices_m, bare.triangles, at, materials=(found.material,))
