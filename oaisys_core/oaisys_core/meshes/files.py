"""Reading user meshes from .obj, .glb, .gltf, .ply, .stl and .blend files."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import BackendUnavailableError, InvalidInputError
from oaisys_core.meshes.checks import check_mesh, check_uv
from oaisys_core.python_programs import python_command, python_environment
from oaisys_core.types import FloatArray, ShortRepr

SUFFIXES = (".obj", ".glb", ".gltf", ".ply", ".stl", ".blend")
Y_UP_SUFFIXES = (".glb", ".gltf")
"""Formats with y up by their standard, which are rotated to z up; others are left as they are."""

R_Z_UP_FROM_Y_UP: FloatArray = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

BLEND_TIMEOUT_S = 120.0


@dataclass(frozen=True, repr=False)
class LoadedMesh(ShortRepr):
    """A mesh as it is in its file.

    Attributes:
        name: Name of the object, or of the file.
        vertices_m: (V, 3) float32, z up, in the units of the file.
        triangles: (T, 3) int32.
        uv: (T, 3, 2) float32 texture coordinates of the corners, v up; None without an image.
        color_image_srgb: (H, W, 3) uint8, row 0 at the top; None without a texture.
        vertex_colors_srgb: (V, 3) uint8; None without vertex colours.
    """

    name: str
    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float32] | None = None
    color_image_srgb: NDArray[np.uint8] | None = None
    vertex_colors_srgb: NDArray[np.uint8] | None = None


def load_mesh(path: Path, object_name: str | None = None, field: str = "file") -> LoadedMesh:
    """Return the mesh of a file, or of one object in it; several objects are merged.

    A separate process reads .blend files, without running the scripts in them.

    Args:
        path: The file.
        object_name: Name of the object; None for all objects.
        field: Name of the file's field in errors.

    Raises:
        InvalidInputError: The file cannot be read, has no such object or no triangles, or cannot
            be rendered, see `check_mesh`.
        BackendUnavailableError: It is a .blend file and ``bpy`` is not installed.
    """
    import trimesh

    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInputError(field, str(path), f"a file that ends in {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InvalidInputError(field, str(path), "an existing file")
    if path.suffix.lower() == ".blend":
        return _load_blend(path, object_name, field)
    try:
        scene = trimesh.load_scene(path, process=False)
    # The exception that trimesh raises depends on the format.
    except Exception as error:
        expected = f"a readable {path.suffix} file ({error})"
        raise InvalidInputError(field, str(path), expected) from error
    parts = dict(_named_parts(scene))
    if object_name is not None:
        if object_name not in parts:
            raise _no_such_object(field, object_name, parts)
        parts = {object_name: parts[object_name]}
    meshes = [mesh for mesh in parts.values() if len(mesh.faces)]
    if not meshes:
        raise InvalidInputError(field, str(path), "a file with at least one triangle")
    for mesh in meshes:
        check_mesh(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces), path, field)
    turned = path.suffix.lower() in Y_UP_SUFFIXES
    loaded = [_loaded(object_name or path.stem, mesh, turned) for mesh in meshes]
    check_uv((mesh.uv for mesh in loaded), path, field)
    return _merged(loaded)


def _named_parts(scene: Any) -> Iterable[tuple[str, Any]]:
    """Yield the objects of a file by name, in the coordinates of the scene."""
    import trimesh

    for node in scene.graph.nodes_geometry:
        T, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if isinstance(mesh, trimesh.Trimesh):
            yield str(node), mesh.copy().apply_transform(T)


def _loaded(name: str, mesh: Any, turned: bool) -> LoadedMesh:
    vertices_m = np.asarray(mesh.vertices, np.float64)
    if turned:
        vertices_m = vertices_m @ R_Z_UP_FROM_Y_UP.T
    triangles = np.asarray(mesh.faces, np.int32)
    image = _texture(mesh.visual)
    uv = getattr(mesh.visual, "uv", None)
    if image is not None and uv is not None:
        by_corner = np.asarray(uv, np.float32)[triangles]
        return LoadedMesh(name, vertices_m.astype(np.float32), triangles, by_corner, image)
    colors = _vertex_colors(mesh)
    return LoadedMesh(name, vertices_m.astype(np.float32), triangles, vertex_colors_srgb=colors)


def _texture(visual: Any) -> NDArray[np.uint8] | None:
    material = getattr(visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    return None if image is None else np.array(image.convert("RGB"), np.uint8)


def _vertex_colors(mesh: Any) -> NDArray[np.uint8] | None:
    visual = mesh.visual
    if visual.kind == "texture":
        color = np.asarray(visual.material.main_color, np.uint8)[:3]
        return np.tile(color, (len(mesh.vertices), 1))
    if visual.kind is None:
        return None
    return np.array(visual.vertex_colors[:, :3], np.uint8)


def _merged(meshes: list[LoadedMesh]) -> LoadedMesh:
    """Return several meshes as one; each texture is replaced by its mean colour."""
    if len(meshes) == 1:
        return meshes[0]
    colors = [_colors_of(mesh) for mesh in meshes]
    starts = np.cumsum([0] + [len(mesh.vertices_m) for mesh in meshes[:-1]])
    known = any(color is not None for color in colors)
    return LoadedMesh(
        name=meshes[0].name,
        vertices_m=np.concatenate([mesh.vertices_m for mesh in meshes]),
        triangles=np.concatenate(
            [m.triangles + np.int32(start) for m, start in zip(meshes, starts, strict=True)]
        ),
        vertex_colors_srgb=np.concatenate(
            [
                np.full((len(mesh.vertices_m), 3), 128, np.uint8) if color is None else color
                for mesh, color in zip(meshes, colors, strict=True)
            ]
        )
        if known
        else None,
    )


def _colors_of(mesh: LoadedMesh) -> NDArray[np.uint8] | None:
    image = mesh.color_image_srgb
    if image is None:
        return mesh.vertex_colors_srgb
    mean = image.reshape(-1, 3).mean(axis=0).round().astype(np.uint8)
    return np.tile(mean, (len(mesh.vertices_m), 1))


def _load_blend(path: Path, object_name: str | None, field: str) -> LoadedMesh:
    with tempfile.TemporaryDirectory(prefix="oaisys-") as folder:
        out = Path(folder, "mesh.npz")
        reader = "oaisys_core.backend.blender.objects.blend_files"
        command = python_command(reader, str(path.resolve()), str(out), object_name or "")
        try:
            ended = subprocess.run(
                command,
                env=python_environment(),
                capture_output=True,
                text=True,
                timeout=BLEND_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            expected = f"a .blend file that loads within {BLEND_TIMEOUT_S:g} s"
            raise InvalidInputError(field, str(path), expected) from error
        said = (ended.stderr.strip().splitlines() or ["no message"])[-1]
        if "BackendUnavailableError" in said or "No module named 'bpy'" in said:
            raise BackendUnavailableError(f"{field}: {path} needs Blender: bpy is not installed")
        if ended.returncode or not out.exists():
            raise InvalidInputError(field, str(path), f"a readable .blend file ({said})")
        with np.load(out, allow_pickle=False) as arrays:
            found = dict(arrays)
    if "names" in found:
        raise _no_such_object(field, object_name or "", found["names"].tolist())
    check_mesh(found["vertices_m"].astype(np.float64), found["triangles"], path, field)
    check_uv([found.get("uv")], path, field)
    return LoadedMesh(
        name=object_name or path.stem,
        vertices_m=found["vertices_m"],
        triangles=found["triangles"],
        uv=found.get("uv"),
        color_image_srgb=found.get("color_image_srgb"),
        vertex_colors_srgb=found.get("vertex_colors_srgb"),
    )


def _no_such_object(field: str, name: str, names: Iterable[str]) -> InvalidInputError:
    known = ", ".join(sorted(names)) or "no object has triangles"
    return InvalidInputError(f"{field} object", name, f"an object with triangles: {known}")
