"""Meshes of glTF files, as their standard says: glTF 2.0, base colours in full."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb
from oaisys_core.errors import InvalidInputError, show_field
from oaisys_core.files.mesh_formats.mesh_headers import MAX_VERTICES, inner_images, read_gltf
from oaisys_core.files.mesh_formats.mesh_texts import check_parts
from oaisys_core.procedural.meshes.gltf_format.gltf_accessors import Accessors
from oaisys_core.procedural.meshes.gltf_format.gltf_materials import GltfMaterials
from oaisys_core.procedural.meshes.gltf_format.gltf_nodes import Node, node_name, nodes_with_meshes
from oaisys_core.procedural.meshes.gltf_format.gltf_vertices import Skins, Vertices
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.procedural.meshes.references import FileReferences, check_texture
from oaisys_core.types import FloatArray

LOG = logging.getLogger(__name__)

TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of primitives with surfaces; all others are points and lines."""

UNDERSTOOD = ("KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp")
UNDERSTOOD_PREFIXES = ("KHR_materials_", "KHR_lights_", "KHR_animation_", "KHR_xmp")
"""Extensions that a file may require: what they change is read, or changes only what is left out
anyway."""

INSTANCING = "EXT_mesh_gpu_instancing"

CONVERTERS = {
    "KHR_draco_mesh_compression": "open it in Blender and export it without compression, or"
    " `npx @gltf-transform/cli copy IN.glb OUT.glb`",
    "EXT_meshopt_compression": "`npx @gltf-transform/cli copy IN.glb OUT.glb`, or gltfpack"
    " without -c",
    "KHR_meshopt_compression": "`npx @gltf-transform/cli copy IN.glb OUT.glb`",
    "KHR_texture_basisu": "`npx @gltf-transform/cli ktxdecompress IN.glb OUT.glb` (KTX2 to PNG)",
    "MSFT_texture_dds": "textures as PNG",
    "EXT_texture_avif": "textures as PNG",
    INSTANCING: "instances as nodes",
}
"""How to get rid of an extension."""


def load_gltf(path: Path, object_name: str | None, field: str) -> list[LoadedMesh] | list[str]:
    """Return the parts of a file, or of one node and those below it, turned to z up.

    Args:
        path: The file, whose size has been checked.
        object_name: Name of the node, or of its mesh; None for all of the scene.
        field: Name of the file's field in errors.

    Returns:
        The parts; or the names of all nodes with meshes, if none has that name.

    Raises:
        InvalidInputError: It cannot be read, or needs what is not read.
    """
    document, binary = read_gltf(path, field)
    references = FileReferences(path, field)
    accessors = Accessors(document, binary, references.get)
    materials = GltfMaterials(document, accessors, references.find, str(path))
    try:
        _check_extensions(document, path, field)
        for name, data in inner_images(document, binary):
            check_texture(data, f"{path}: {name}")
        nodes = list(nodes_with_meshes(document))
        chosen = [node for node in nodes if _is_named(document, node, object_name)]
        if object_name is not None and not chosen:
            return sorted({node_name(document, index) for index, _, _ in nodes})
        _check_size(document, chosen)
        primitives = _Primitives(document, accessors, materials)
        parts = [part for index, T, _ in chosen for part in primitives.of_node(index, T)]
        references.tell_missing()
        _tell_unused(document, materials, path)
    except (ArithmeticError, AttributeError, LookupError, OSError, TypeError, ValueError) as error:
        expected = f"a glTF file that can be read ({type(error).__name__}: {error})"
        raise InvalidInputError(field, str(path), expected) from error
    return parts


def _check_extensions(document: Mapping[str, Any], path: Path, field: str) -> None:
    """Raise on extensions without which the file has another shape or colour."""
    version = str(document.get("asset", {}).get("version", "2.0"))
    if not version.startswith("2."):
        expected = f"glTF 2.x, not {version[:20]!r} (`npx gltf-pipeline -i IN -o OUT` converts it)"
        raise InvalidInputError(field, str(path), expected)
    required = [str(each) for each in document.get("extensionsRequired", ())]
    for extension in required:
        if _is_understood(extension):
            continue
        how = CONVERTERS.get(extension, "save it without this extension")
        raise InvalidInputError(field, str(path), f"a file that needs no {extension}: {how}")
    if any(INSTANCING in node.get("extensions", {}) for node in document.get("nodes", ())):
        expected = f"a file whose nodes need no {INSTANCING}: {CONVERTERS[INSTANCING]}"
        raise InvalidInputError(field, str(path), expected)
    for texture in document.get("textures", ()):
        for extension in texture.get("extensions", {}):
            if "source" not in texture and extension in CONVERTERS:
                how = CONVERTERS[extension]
                expected = f"a file whose textures need no {extension}: {how}"
                raise InvalidInputError(field, str(path), expected)


def _is_understood(extension: str) -> bool:
    return extension in UNDERSTOOD or extension.startswith(UNDERSTOOD_PREFIXES)


def _is_named(document: Mapping[str, Any], node: Node, name: str | None) -> bool:
    """Return whether a node, its mesh, or a node above it has a name."""
    index, _, above = node
    if name is None:
        return True
    mesh = document["meshes"][document["nodes"][index]["mesh"]]
    names = {node_name(document, each) for each in (index, *above)} | {str(mesh.get("name"))}
    return name in names


def _check_size(document: Mapping[str, Any], nodes: Sequence[Node]) -> None:
    """Raise if the instances of meshes have too many primitives or triangles."""
    meshes = [document["meshes"][document["nodes"][index]["mesh"]] for index, _, _ in nodes]
    primitives = sum(len(mesh["primitives"]) for mesh in meshes)
    check_parts(primitives, f"primitives, each instance counts, not {primitives}: join them")
    corners = 0
    for mesh in meshes:
        for primitive in mesh["primitives"]:
            accessor = primitive.get("indices", primitive["attributes"].get("POSITION"))
            if accessor is not None:
                corners += int(document["accessors"][accessor]["count"])
    if corners > 3 * MAX_VERTICES:
        raise ValueError(f"at most {MAX_VERTICES} triangles, not {corners // 3}")


class _Primitives:
    """Reads the primitives of nodes."""

    def __init__(
        self, document: Mapping[str, Any], accessors: Accessors, materials: GltfMaterials
    ) -> None:
        self._document, self._accessors, self._materials = document, accessors, materials
        self._skins = Skins(document, accessors)

    def of_node(self, index: int, T: FloatArray) -> Iterator[LoadedMesh]:
        """Yield the surfaces of a node's mesh, at its pose, or where its skin has it."""
        node = self._document["nodes"][index]
        mesh = self._document["meshes"][node["mesh"]]
        weights = node.get("weights", mesh.get("weights"))
        joints = None if node.get("skin") is None else self._skins.poses(node["skin"])
        for primitive in mesh["primitives"]:
            mode = int(primitive.get("mode", TRIANGLES))
            if mode in (TRIANGLES, STRIP, FAN) and "POSITION" in primitive["attributes"]:
                where = f"mesh {node['mesh']}"
                vertices = Vertices(self._document, self._accessors, primitive, weights, where)
                points, mirrored = vertices.points(T, joints)
                name = node_name(self._document, index)
                surface = self._surface(name, primitive, vertices, points, mirrored=mirrored)
                poses = T if joints is None else joints
                yield replace(surface, float32=vertices.float32_step(poses, surface.triangles))

    def _surface(
        self,
        name: str,
        primitive: Mapping[str, Any],
        vertices: Vertices,
        points: FloatArray,
        *,
        mirrored: bool,
    ) -> LoadedMesh:
        order = np.arange(len(points))
        if "indices" in primitive:
            order = self._accessors.integers(int(primitive["indices"]))
        triangles = _triangles(order, int(primitive.get("mode", TRIANGLES)))
        if mirrored:
            triangles = np.ascontiguousarray(triangles[:, ::-1])
        if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(points):
            raise ValueError("indices without vertices")
        base = self._materials.base_color(primitive.get("material"))
        uv = vertices.floats(f"TEXCOORD_{base.uv_set}")
        if uv is not None:
            uv = transform_uv(uv, base.transform)
            uv = np.stack((uv[:, 0], 1 - uv[:, 1]), axis=1).astype(np.float32)[triangles]
        elif base.material.color_image_srgb is not None or base.material.opacity is not None:
            LOG.warning("%s: lacks TEXCOORD_%d, by which its image lies", name, base.uv_set)
        colors = vertices.colors()
        return LoadedMesh(
            name=name,
            vertices_m=points,
            triangles=triangles,
            uv=uv,
            vertex_colors_srgb=None if colors is None else encode_srgb(colors),
            materials=(base.material,),
        )


def transform_uv(uv: FloatArray, transform: FloatArray) -> FloatArray:
    """Return (N, 2) texture coordinates after a (2, 3) affine transform."""
    return np.asarray(uv @ transform[:, :2].T + transform[:, 2])


def _triangles(order: NDArray[np.int64], mode: int) -> NDArray[np.int32]:
    """Return the (T, 3) corners of a list, strip or fan of triangles (§3.7.2.1)."""
    if mode == TRIANGLES:
        corners = order[: len(order) // 3 * 3].reshape(-1, 3)
    elif mode == STRIP:
        corners = np.stack((order[:-2], order[1:-1], order[2:]), axis=1)
        corners[1::2, 1:] = corners[1::2, :0:-1].copy()
    else:
        first = np.broadcast_to(order[:1], len(order) - 2)
        corners = np.stack((order[1:-1], order[2:], first), axis=1)
    return np.ascontiguousarray(corners, np.int32)


def _tell_unused(document: Mapping[str, Any], materials: GltfMaterials, path: Path) -> None:
    """Log what the file says that is left out."""
    used = map(str, document.get("extensionsUsed", ()))
    # Where a texture or a primitive needs one of `CONVERTERS`, it was refused.
    unread = [each for each in used if not _is_understood(each) and each not in CONVERTERS]
    if unread:
        names = ", ".join(map(show_field, unread))
        LOG.warning("%s: extensions that are not read, which may change it: %s", path, names)
    unused = set(materials.unused)
    unused |= {what for what in ("animations", "cameras") if document.get(what)}
    if unused:
        LOG.info("%s: not used: %s", path, ", ".join(sorted(unused)))
