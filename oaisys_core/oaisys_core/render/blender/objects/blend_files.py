"""Reads a mesh from a .blend, COLLADA or USD file, in a process of its own, `blend_program`.

Scripts and drivers of Python in the file are not run; what such a driver drives stays as saved.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import quote
from oaisys_core.files.mesh_formats.collada_texts import ColladaText
from oaisys_core.files.references import lies_within
from oaisys_core.geometry import transform_points
from oaisys_core.procedural.meshes.checks import float32_step
from oaisys_core.procedural.meshes.loaded import LoadedMesh, merge_parts
from oaisys_core.procedural.meshes.mesh_arrays import mesh_to_arrays
from oaisys_core.render.blender.objects.blend_arrays import too_many_triangles
from oaisys_core.render.blender.objects.blend_drivers import mute_python_drivers
from oaisys_core.render.blender.objects.blend_images import too_many_pixels
from oaisys_core.render.blender.objects.blend_materials import (
    BlendMaterial,
    images_of,
    read_material,
)
from oaisys_core.render.blender.objects.usd_references import (
    USD_SUFFIXES,
    check_unit,
    references_of,
)

RANDOM_CELL = 1e-3
"""Size of the cells, in a texture's coordinates, of the noise that replaces random numbers."""

OTHER_SURFACES = ("CURVE", "SURFACE", "META", "FONT")
"""Types of objects that may have faces and are not read."""

MAX_INSTANCES = 100_000
"""Instances that are looked at."""

READING_NODES = "GeometryNodeImport"
"""Start of the names of geometry nodes that read files, whose paths may be computed."""


def read_by_blender(
    path: Path, object_name: str, folders: tuple[Path, ...]
) -> dict[str, NDArray[Any]]:
    """Return the mesh of the named object, or of all objects merged if ``object_name`` is empty.

    Args:
        path: The file.
        object_name: Name of the object.
        folders: Where the files that it refers to may lie, links resolved.

    Returns:
        Arrays of `mesh_to_arrays`, and ``warnings``; or only ``names``, of the objects with
        triangles, if none has that name. Alone are also: ``outside``, the name of a file elsewhere
        to which it refers; ``random``, what would be expected of objects whose shape is drawn anew
        each time; ``importer``, that Blender cannot read the format; ``invalid``, what would be
        expected of a file that Blender would read otherwise than it says.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    warnings: list[str] = []
    try:
        references = list(_references(path, folders))
    except ET.ParseError as error:
        references = []
        warnings.append(f"its images and indices are not checked ({error})")
    except ValueError as error:
        return {"invalid": np.array(str(error))}
    for name, place in references:
        if "://" in name or not lies_within(place, folders):
            return {"outside": np.array(name)}
        if not place.exists() and "<UDIM>" not in name:
            warnings.append(f"{name!r} is missing, and what it adds")
    failed = _load(path)
    if failed is not None:
        return {"importer": np.array(failed)}
    warnings += _unread_images(path, references)
    _forget_unused_caches()
    outside = _outside(path, folders)
    if outside is not None:
        return {"outside": np.array(outside)}
    warnings += mute_python_drivers()
    warnings += replace_random_textures()
    things = [thing for thing in bpy.context.scene.objects if thing.type == "MESH"]
    chosen = [thing for thing in things if object_name in ("", thing.name)]
    refusal = _refusal(chosen)
    if refusal is not None:
        return refusal
    parts = [part for part in (_part(thing, warnings) for thing in chosen) if len(part.triangles)]
    if not parts:
        names = sorted(t.name for t in things if t not in chosen and _has_faces(t))
        return {"names": np.array(names, dtype=np.str_)}
    warnings += _left_out(chosen if object_name else list(bpy.context.scene.objects))
    texts = np.array(list(dict.fromkeys(warnings)), dtype=np.str_)
    return {**mesh_to_arrays(merge_parts(path.stem, parts)), "warnings": texts}


def _references(path: Path, folders: tuple[Path, ...]) -> Iterator[tuple[str, Path]]:
    """Yield what a COLLADA or USD file refers to, as written and as a path.

    Raises:
        ValueError: It says what would be read as something else, or left out.
        ET.ParseError: It is COLLADA that cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix in USD_SUFFIXES:
        check_unit(path)
        yield from references_of(path, folders)
    elif suffix == ".dae":
        yield from ColladaText(path).references(path.parent)


def _unread_images(path: Path, references: Sequence[tuple[str, Path]]) -> list[str]:
    """Return warnings of images beside a COLLADA file that Blender did not find."""
    if path.suffix.lower() != ".dae":
        return []
    read = {Path(image.filepath).name for image in bpy.data.images}
    return [
        f"the image {name!r} is not read: write its address as a URI, with %20 for a space"
        for name, place in references
        if place.exists() and place.name not in read
    ]


def _load(path: Path) -> str | None:
    """Add a file's objects to the scene, or return why Blender cannot."""
    suffix = path.suffix.lower()
    if suffix == ".blend":
        with bpy.data.libraries.load(str(path), link=False) as (source, target):
            target.objects = list(source.objects)
        for thing in target.objects:
            if thing is not None:
                bpy.context.scene.collection.objects.link(thing)
        return None
    name = "collada_import" if suffix == ".dae" else "usd_import"
    if name not in dir(bpy.ops.wm):
        version = bpy.app.version_string
        return (
            f"Blender {version} reads no {suffix} files (COLLADA: up to 4.5); save it as .glb, for"
            " example with Blender 4.5"
        )
    getattr(bpy.ops.wm, name)(filepath=str(path))
    return None


def _forget_unused_caches() -> None:
    """Clear the paths of ocean modifiers that have nothing baked, and read no file.

    By default, such a path is in the temporary folder of whoever saved the file.
    """
    for thing in bpy.data.objects:
        for modifier in thing.modifiers:
            if modifier.type == "OCEAN" and not modifier.is_cached:
                modifier.filepath = ""


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


def replace_random_textures() -> list[str]:
    """Make textures that are drawn anew at each evaluation the same each time; return warnings.

    Blender's Noise texture takes its numbers from the clock. Noise of tiny cells has the same
    spread.
    """
    warnings = []
    for texture in bpy.data.textures:
        if texture.type == "NOISE":
            texture.type = "CLOUDS"
            # The type of the Python object changes with that of the texture.
            same = bpy.data.textures[texture.name]
            same.noise_basis, same.noise_scale, same.noise_depth = "CELL_NOISE", RANDOM_CELL, 0
            warnings.append(
                f"texture {same.name!r} (Noise) has other values each time; noise that repeats"
                " stands in, always the same"
            )
    return warnings


def _refusal(things: list[Any]) -> dict[str, NDArray[Any]] | None:
    """Return what is said of objects that are too much, or not the same each time."""
    too_much = too_many_triangles(things) or too_many_pixels(_images_of(things))
    if too_much is not None:
        return {"invalid": np.array(too_much)}
    random = _random_shape(things)
    if random is not None:
        return {"random": np.array(random)}
    unplaced = _without_place(things)
    return None if unplaced is None else {"invalid": np.array(unplaced)}


def _without_place(things: list[Any]) -> str | None:
    """Return what is expected instead of an object whose position, rotation or scale is not finite.

    The objects are evaluated.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for thing in things:
        T = np.array(thing.evaluated_get(depsgraph).matrix_world, np.float64)
        if not np.isfinite(T).all():
            place, scale = quote(tuple(thing.location)), quote(tuple(thing.scale))
            return (
                f"finite positions, rotations and scales, unlike those of {thing.name!r}"
                f" (position {place}, scale {scale})"
            )
    return None


def _images_of(things: list[Any]) -> Iterator[Any]:
    """Yield the images that are decoded: of the materials of objects, and of what shapes them."""
    materials = {
        slot.material: None for thing in things for slot in thing.material_slots if slot.material
    }
    for material in materials:
        yield from images_of(material)
    yield from (texture.image for texture in bpy.data.textures if getattr(texture, "image", None))
    for tree in bpy.data.node_groups:
        if tree.bl_idname == "GeometryNodeTree":
            sockets = [socket for node in tree.nodes for socket in node.inputs]
            values = (getattr(socket, "default_value", None) for socket in sockets)
            yield from (value for value in values if isinstance(value, bpy.types.Image))


def _random_shape(things: list[Any]) -> str | None:
    """Return what is expected instead of objects whose shape differs when evaluated twice."""
    before = {thing.name: _vertices(thing) for thing in things}
    for thing in things:
        thing.update_tag()
        if thing.data is not None:
            thing.data.update_tag()
    bpy.context.view_layer.update()
    for thing in things:
        after = _vertices(thing)
        if not np.array_equal(before[thing.name], after, equal_nan=True):
            names = [
                f"{modifier.name!r}" + (f" (texture {texture.name!r})" if texture else "")
                for modifier in thing.modifiers
                for texture in [getattr(modifier, "texture", None)]
            ]
            return (
                f"objects with the same shape each time, not {thing.name!r}: apply its modifiers"
                f" {', '.join(names)} in Blender"
            )
    return None


def _left_out(things: list[Any]) -> list[str]:
    """Return warnings of surfaces that are not read: of other types, and shown by instances."""
    others = [thing for thing in things if thing.type in OTHER_SURFACES and _has_faces(thing)]
    names = {thing.name for thing in things} - {thing.name for thing in others}
    instances = bpy.context.evaluated_depsgraph_get().object_instances
    parents = {each.parent.name for each in islice(instances, MAX_INSTANCES) if each.is_instance}
    return [
        f"{thing.name!r} is left out: a {thing.type.lower()} is no mesh (convert it in Blender)"
        for thing in others
    ] + [
        f"what {name!r} shows as instances is left out (make them real in Blender)"
        for name in sorted(parents & names)
    ]


def _has_faces(thing: Any) -> bool:
    """Return whether a curve or the like is more than a line, as it is where it guides others."""
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found = evaluated.to_mesh()
    has_faces = found is not None and len(found.polygons) > 0
    evaluated.to_mesh_clear()
    return has_faces


def _vertices(thing: Any) -> NDArray[np.float32]:
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    vertices = _fill(evaluated.to_mesh().vertices, "co", 3)
    evaluated.to_mesh_clear()
    return vertices


def _part(thing: Any, warnings: list[str]) -> LoadedMesh:
    """Return an object's evaluated mesh in the file's world frame."""
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    T = np.array(evaluated.matrix_world, np.float64)
    triangles = _fill(mesh.loop_triangles, "vertices", 3, np.int32)
    if np.linalg.det(T[:3, :3]) < 0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    points = _fill(mesh.vertices, "co", 3)
    step = float32_step(points, triangles, float(np.linalg.norm(T[:3, :3], ord=2)))
    bare = LoadedMesh(thing.name, transform_points(T, points), triangles, float32=step)
    corners = _fill(mesh.loop_triangles, "loops", 3, np.int32)
    which = np.empty(len(triangles), np.int32)
    mesh.loop_triangles.foreach_get("material_index", which)
    slots = [slot.material for slot in thing.material_slots] or [None]
    which = np.clip(which, 0, len(slots) - 1)
    used = np.unique(which).tolist()
    materials = {index: read_material(slots[index], warnings) for index in used}
    colors = None
    if mesh.color_attributes.active_color is not None:
        colors = _vertex_colors(mesh)
    found = _with_materials(bare, mesh, corners, which, materials, colors)
    evaluated.to_mesh_clear()
    if np.linalg.det(T[:3, :3]) < 0 and found.uv is not None:
        found = replace(found, uv=np.ascontiguousarray(found.uv[:, ::-1]))
    return found


def _with_materials(
    bare: LoadedMesh,
    mesh: Any,
    corners: NDArray[np.int32],
    which: NDArray[np.int32],
    materials: dict[int, BlendMaterial],
    colors: NDArray[np.uint8] | None,
) -> LoadedMesh:
    """Return a mesh with its materials, or with its vertex colours if these say all there is."""
    if all(each.is_plain or each.has_vertex_colors for each in materials.values()):
        if colors is not None:
            return replace(bare, vertex_colors_srgb=colors)
        if len(materials) == 1 and next(iter(materials.values())).material.name == "none":
            return bare
    uv = np.zeros((len(which), 3, 2), np.float32)
    order = list(materials)
    for index in order:
        rows = np.flatnonzero(which == index)
        of_map = mesh.uv_layers.get(materials[index].uv_map) or mesh.uv_layers.active
        if of_map is not None:
            at = _fill(of_map.data, "uv", 2)[corners[rows]].reshape(-1, 2).astype(np.float64)
            at = at @ materials[index].transform[:, :2].T + materials[index].transform[:, 2]
            uv[rows] = at.reshape(-1, 3, 2)
    painted = any(each.has_vertex_colors for each in materials.values())
    return replace(
        bare,
        uv=uv if len(mesh.uv_layers) else None,
        vertex_colors_srgb=colors if painted else None,
        materials=tuple(materials[index].material for index in order),
        material_of=np.searchsorted(order, which).astype(np.uint16),
    )


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
