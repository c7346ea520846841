"""Reading user meshes from .obj, .glb, .gltf, .ply, .stl and .blend files."""

from __future__ import annotations

import json
import subprocess
import time
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import BackendUnavailableError, InvalidInputError
from oaisys_core.files.arrays import load_arrays
from oaisys_core.files.images import MESH_TEXTURE
from oaisys_core.files.mesh_headers import (
    MAX_VERTICES,
    check_mesh_file,
    inner_images,
    read_gltf,
)
from oaisys_core.files.path_fields import is_confined
from oaisys_core.files.references import folders_of, outside_error
from oaisys_core.procedural.meshes.checks import check_mesh, check_uv, local_origin
from oaisys_core.procedural.meshes.references import FileReferences, check_texture
from oaisys_core.system.interruption import stop_if_unwanted
from oaisys_core.system.leftovers import temporary_folder
from oaisys_core.system.python_programs import python_command, python_environment
from oaisys_core.types import FloatArray, ShortRepr

SUFFIXES = (".obj", ".glb", ".gltf", ".ply", ".stl", ".blend")
Y_UP_SUFFIXES = (".glb", ".gltf")
"""Formats with y up by their standard, which are rotated to z up; others are left as they are."""

R_Z_UP_FROM_Y_UP: FloatArray = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

BLEND_TIMEOUT_S = 120.0
"""For a .blend file that the configuration names."""

BLEND_REQUEST_TIMEOUT_S = 15.0
"""For one that a request names: other clients wait as long."""

MAX_BLEND_BYTES = 4_000_000_000
"""Size of the arrays of a mesh."""

MAX_SLOW = 64
LOOK_S = 0.05
_slow: OrderedDict[tuple[Path, int, int], None] = OrderedDict()
"""Files that took too long, with their time and size: they are refused at once."""


@dataclass(frozen=True, repr=False)
class LoadedMesh(ShortRepr):
    """A mesh as it is in its file.

    Attributes:
        name: Name of the object, or of the file.
        vertices_m: (V, 3), z up, in the units of the file: float32, or float64 where float32 is
            too coarse, far from the origin, see
            `oaisys_core.procedural.meshes.checks.local_origin`.
        triangles: (T, 3) int32.
        uv: (T, 3, 2) float32 texture coordinates of the corners, v up; None without an image.
        color_image_srgb: (H, W, 3) uint8, row 0 at the top; None without a texture.
        vertex_colors_srgb: (V, 3) uint8; None without vertex colours.
    """

    name: str
    vertices_m: NDArray[Any]
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
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInputError(field, str(path), f"a file that ends in {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InvalidInputError(field, str(path), "an existing file")
    if path.suffix.lower() == ".blend":
        return _load_blend(path, object_name, field)
    scene = _load_scene(path, field)
    triangles = sum(
        len(getattr(scene.geometry[scene.graph[node][1]], "faces", ()))
        for node in scene.graph.nodes_geometry
    )
    if triangles > MAX_VERTICES:
        expected = f"at most {MAX_VERTICES} triangles, not {triangles}"
        raise InvalidInputError(field, str(path), expected)
    parts = dict(_parts_by_name(scene))
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
    loaded = [_load(object_name or path.stem, mesh, turned) for mesh in meshes]
    check_uv((mesh.uv for mesh in loaded), path, field)
    return _as_float32(_merge(loaded))


def _load_scene(path: Path, field: str) -> Any:
    """Return what trimesh reads from a file, and from others beside it."""
    import trimesh

    check_mesh_file(path, field)
    if path.suffix.lower() in Y_UP_SUFFIXES:
        for name, data in inner_images(*read_gltf(path, field)):
            check_texture(data, f"{path}: {name}")
    references = FileReferences(path, field)
    try:
        with path.open("rb") as file:
            scene = trimesh.load_scene(
                file,
                file_type=path.suffix.lower()[1:],
                resolver=references,
                process=False,
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


def _as_float32(mesh: LoadedMesh) -> LoadedMesh:
    """Return a mesh with float32 vertices, unless they are so far out that this loses precision."""
    if local_origin(mesh.vertices_m).any():
        return mesh
    return replace(mesh, vertices_m=mesh.vertices_m.astype(np.float32))


def _parts_by_name(scene: Any) -> Iterable[tuple[str, Any]]:
    """Yield the objects of a file by name, in the coordinates of the scene."""
    import trimesh

    for node in scene.graph.nodes_geometry:
        T, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if isinstance(mesh, trimesh.Trimesh):
            yield str(node), mesh.copy().apply_transform(T)


def _load(name: str, mesh: Any, turned: bool) -> LoadedMesh:
    vertices_m = np.asarray(mesh.vertices, np.float64)
    if turned:
        vertices_m = vertices_m @ R_Z_UP_FROM_Y_UP.T
    triangles = np.asarray(mesh.faces, np.int32)
    image = _texture(mesh.visual)
    uv = getattr(mesh.visual, "uv", None)
    if image is not None and uv is not None:
        by_corner = np.asarray(uv, np.float32)[triangles]
        return LoadedMesh(name, vertices_m, triangles, by_corner, image)
    colors = _vertex_colors(mesh)
    return LoadedMesh(name, vertices_m, triangles, vertex_colors_srgb=colors)


def _texture(visual: Any) -> NDArray[np.uint8] | None:
    material = getattr(visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is None:
        return None
    width, height = image.size
    MESH_TEXTURE.check(width, height, "a mesh's texture")
    return np.array(image.convert("RGB"), np.uint8)


def _vertex_colors(mesh: Any) -> NDArray[np.uint8] | None:
    visual = mesh.visual
    if visual.kind == "texture":
        color = np.asarray(visual.material.main_color, np.uint8)[:3]
        return np.tile(color, (len(mesh.vertices), 1))
    if visual.kind is None:
        return None
    return np.array(visual.vertex_colors[:, :3], np.uint8)


def _merge(meshes: list[LoadedMesh]) -> LoadedMesh:
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
    with temporary_folder("oaisys-") as folder:
        found = _read_blend(path, object_name, field, folder)
    if "outside" in found:
        raise outside_error(path, str(found["outside"]), field)
    if "names" in found:
        raise _no_such_object(field, object_name or "", found["names"].tolist())
    if max(len(found["vertices_m"]), len(found["triangles"])) > MAX_VERTICES:
        expected = f"at most {MAX_VERTICES} vertices and triangles, not {len(found['triangles'])}"
        raise InvalidInputError(field, str(path), expected)
    check_mesh(found["vertices_m"], found["triangles"], path, field)
    check_uv([found.get("uv")], path, field)
    mesh = LoadedMesh(
        name=object_name or path.stem,
        vertices_m=found["vertices_m"],
        triangles=found["triangles"],
        uv=found.get("uv"),
        color_image_srgb=found.get("color_image_srgb"),
        vertex_colors_srgb=found.get("vertex_colors_srgb"),
    )
    return _as_float32(mesh)


def _read_blend(
    path: Path, object_name: str | None, field: str, folder: Path
) -> dict[str, NDArray[Any]]:
    """Return what a process of its own finds in a .blend file."""
    out, log = folder / "mesh.npz", folder / "log"
    time_s = BLEND_REQUEST_TIMEOUT_S if is_confined() else BLEND_TIMEOUT_S
    task = {
        "file": str(path.resolve()),
        "object_name": object_name or "",
        "out": str(out),
        "folders": [str(each) for each in folders_of(path)],
        "time_s": int(time_s) + 5,
    }
    command = python_command("oaisys_core.render.blender.blend_program", json.dumps(task))
    status = path.stat()
    version = (path.resolve(), status.st_mtime_ns, status.st_size)
    expected = f"a .blend file that loads within {time_s:g} s"
    if version in _slow:
        raise InvalidInputError(field, str(path), expected)
    with log.open("wb") as output:
        try:
            code = _code_of(command, output, folder, time_s)
        except subprocess.TimeoutExpired as error:
            _slow[version] = None
            while len(_slow) > MAX_SLOW:
                _slow.popitem(last=False)
            raise InvalidInputError(field, str(path), expected) from error
    lines = log.read_bytes()[-10_000:].decode(errors="replace").strip().splitlines()
    said = next((line for line in reversed(lines) if "Error" in line), "no message")[:300]
    if "BackendUnavailableError" in said or "No module named 'bpy'" in said:
        raise BackendUnavailableError(f"{field}: {path} needs Blender: bpy is not installed")
    if code or not out.exists():
        raise InvalidInputError(field, str(path), f"a readable .blend file ({said})")
    return load_arrays(out, MAX_BLEND_BYTES)


def _code_of(command: list[str], output: IO[bytes], folder: Path, time_s: float) -> int:
    """Run the reader and return its exit code; it is killed once nobody wants what it finds."""
    environment = {**python_environment(), "TMPDIR": str(folder)}
    process = subprocess.Popen(
        command, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=output
    )
    deadline_s = time.monotonic() + time_s
    try:
        while True:
            stop_if_unwanted()
            left_s = deadline_s - time.monotonic()
            try:
                return process.wait(min(max(left_s, 0.0), LOOK_S))
            except subprocess.TimeoutExpired:
                if left_s <= 0:
                    raise
    finally:
        process.kill()
        process.wait()


def _no_such_object(field: str, name: str, names: Iterable[str]) -> InvalidInputError:
    known = ", ".join(sorted(names)) or "no object has triangles"
    return InvalidInputError(f"{field} object", name, f"an object with triangles: {known}")
