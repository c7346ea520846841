"""Reads a mesh from a .blend file, in a process of its own, `blend_program`.

Scripts and drivers of Python in the file are not run.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb
from oaisys_core.files.images import MESH_TEXTURE
from oaisys_core.files.references import lies_within
from oaisys_core.geometry import transform_points

READING_NODES = "GeometryNodeImport"
"""Start of the names of geometry nodes that read files, whose paths may be computed."""


def read_blend(path: Path, object_name: str, folders: tuple[Path, ...]) -> dict[str, NDArray[Any]]:
    """Return the mesh of the named object, or of all objects merged if ``object_name`` is empty.

    Args:
        path: The file.
        object_name: Name of the object.
        folders: Where the files that it refers to may lie, links resolved.

    Returns:
        ``vertices_m``, ``triangles`` and, if present, ``uv``, ``color_image_srgb`` and
        ``vertex_colors_srgb``, as in `oaisys_core.procedural.meshes.files.LoadedMesh`; or only
        ``names``, of the objects with triangles, if none has that name. ``outside`` alone is the
        name of a file elsewhere to which it refers.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    with bpy.data.libraries.load(str(path), link=False) as (source, target):
        target.objects = list(source.objects)
    outside = _outside(path, folders)
    if outside is not None:
        return {"outside": np.array(outside)}
    things = [thing for thing in target.objects if thing is not None]
    for thing in things:
        bpy.context.scene.collection.objects.link(thing)
    parts = {thing.name: _arrays(thing) for thing in things if thing.type == "MESH"}
    parts = {name: part for name, part in parts.items() if len(part["triangles"])}
    chosen = [part for name, part in parts.items() if object_name in ("", name)]
    if not chosen:
        return {"names": np.array(sorted(parts), dtype=np.str_)}
    if len(chosen) == 1:
        return chosen[0]
    starts = np.cumsum([0] + [len(part["vertices_m"]) for part in chosen[:-1]])
    return {
        "vertices_m": np.concatenate([part["vertices_m"] for part in chosen]),
        "triangles": np.concatenate(
            [p["triangles"] + np.int32(s) for p, s in zip(chosen, starts, strict=True)]
        ),
        "vertex_colors_srgb": np.concatenate([_plain_colors(part) for part in chosen]),
    }


def _outside(path: Path, folders: tuple[Path, ...]) -> str | None:
    """Return what a file that was loaded, but not evaluated, refers to outside of the folders."""
    names = [name for name in bpy.utils.blend_paths(absolute=True, packed=False) if name]
    names += [library.filepath for library in bpy.data.libraries]
    names += [
        name
        for thing in bpy.data.objects
        for modifier in thing.modifiers
        if modifier.type == "NODES"
        for name in (modifier.bake_directory, *(bake.directory for bake in modifier.bakes))
        if name
    ]
    for name in names:
        place = Path(bpy.path.abspath(name, start=str(path.parent)))
        if not lies_within(path.parent / place, folders):
            return str(name)
    nodes = [node for tree in bpy.data.node_groups for node in tree.nodes]
    return next((str(n.bl_label) for n in nodes if n.bl_idname.startswith(READING_NODES)), None)


def _arrays(thing: Any) -> dict[str, NDArray[Any]]:
    """Return an object's evaluated mesh in the file's world frame."""
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    local = _fill(mesh.vertices, "co", 3)
    T = np.array(evaluated.matrix_world, np.float64)
    found: dict[str, NDArray[Any]] = {
        "vertices_m": transform_points(T, local),
        "triangles": _fill(mesh.loop_triangles, "vertices", 3, np.int32),
    }
    corners = _fill(mesh.loop_triangles, "loops", 3, np.int32)
    image = _base_image(thing)
    if image is not None and mesh.uv_layers.active is not None:
        found["uv"] = _fill(mesh.uv_layers.active.data, "uv", 2)[corners]
        found["color_image_srgb"] = image
    elif mesh.color_attributes.active_color is not None:
        found["vertex_colors_srgb"] = _vertex_colors(mesh)
    elif (color := _base_color(thing)) is not None:
        found["vertex_colors_srgb"] = np.tile(color, (len(local), 1))
    evaluated.to_mesh_clear()
    return found


def _fill(items: Any, name: str, width: int, dtype: Any = np.float32) -> NDArray[Any]:
    values = np.empty(len(items) * width, dtype)
    items.foreach_get(name, values)
    return values.reshape(-1, width)


def _vertex_colors(mesh: Any) -> NDArray[np.uint8]:
    """Return one colour per vertex, the mean if its corners have different ones."""
    attribute = mesh.color_attributes.active_color
    values = _fill(attribute.data, "color_srgb", 4)[:, :3]
    if attribute.domain == "CORNER":
        vertex = np.empty(len(mesh.loops), np.int32)
        mesh.loops.foreach_get("vertex_index", vertex)
        total = np.zeros((len(mesh.vertices), 3))
        np.add.at(total, vertex, values)
        values = total / np.maximum(np.bincount(vertex, minlength=len(total)), 1)[:, None]
    return np.asarray(np.rint(np.clip(values, 0, 1) * 255), np.uint8)


def _find_principled(thing: Any) -> Any:
    """Return the first principled shader among an object's materials, or None."""
    for slot in thing.material_slots:
        tree = slot.material.node_tree if slot.material is not None else None
        for node in tree.nodes if tree is not None else ():
            if node.type == "BSDF_PRINCIPLED":
                return node
    return None


def _base_image(thing: Any) -> NDArray[np.uint8] | None:
    shader = _find_principled(thing)
    links = shader.inputs["Base Color"].links if shader is not None else ()
    image = links[0].from_node.image if links and links[0].from_node.type == "TEX_IMAGE" else None
    if image is None or (not image.has_data and not image.pixels):
        return None
    width, height = image.size
    MESH_TEXTURE.check(width, height, image.name)
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    rgb = pixels.reshape(height, width, -1)[::-1, :, :3]
    return np.ascontiguousarray(np.rint(np.clip(rgb, 0, 1) * 255).astype(np.uint8))


def _base_color(thing: Any) -> NDArray[np.uint8] | None:
    shader = _find_principled(thing)
    if shader is None:
        return None
    return encode_srgb(np.array(shader.inputs["Base Color"].default_value[:3]))


def _plain_colors(part: dict[str, NDArray[Any]]) -> NDArray[np.uint8]:
    count = len(part["vertices_m"])
    if "vertex_colors_srgb" in part:
        return part["vertex_colors_srgb"]
    if "color_image_srgb" in part:
        mean = part["color_image_srgb"].reshape(-1, 3).mean(axis=0)
        return np.tile(mean.round().astype(np.uint8), (count, 1))
    return np.full((count, 3), 128, np.uint8)
