"""Meshes of glTF files, as their standard says: glTF 2.0, base colours in full."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.mesh_headers import MAX_VERTICES, inner_images, read_gltf
from oaisys_core.geometry import transform_points
from oaisys_core.procedural.meshes.gltf_accessors import Accessors
from oaisys_core.procedural.meshes.gltf_materials import GltfMaterials
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

CONVERTERS = {
    "KHR_draco_mesh_compression": "open it in Blender and export it without compression, or"
    " `npx @gltf-transform/cli copy IN.glb OUT.glb`",
    "EXT_meshopt_compression": "`npx @gltf-transform/cli copy IN.glb OUT.glb`, or gltfpack"
    " without -c",
    "KHR_meshopt_compression": "`npx @gltf-transform/cli copy IN.glb OUT.glb`",
    "KHR_texture_basisu": "`npx @gltf-transform/cli ktxdecompress IN.glb OUT.glb` (KTX2 to PNG)",
    "MSFT_texture_dds": "textures as PNG",
    "EXT_texture_avif": "textures as PNG",
    "EXT_mesh_gpu_instancing": "instances as nodes",
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
        nodes = list(_nodes(document))
        chosen = [node for node in nodes if _is_named(document, node, object_name)]
        if object_name is not None and not chosen:
            return sorted({_name(document, index) for index, _, _ in nodes})
        _check_size(document, chosen)
        parts = [
            part
            for index, T, _ in chosen
            for part in _Primitives(document, accessors, materials).of_node(index, T)
        ]
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
        if extension in UNDERSTOOD or extension.startswith(UNDERSTOOD_PREFIXES):
            continue
        how = CONVERTERS.get(extension, "save it without this extension")
        raise InvalidInputError(field, str(path), f"a file that needs no {extension}: {how}")
    for texture in document.get("textures", ()):
        for extension in texture.get("extensions", {}):
            if "source" not in texture and extension in CONVERTERS:
                how = CONVERTERS[extension]
                expected = f"a file whose textures need no {extension}: {how}"
                raise InvalidInputError(field, str(path), expected)


def _nodes(document: Mapping[str, Any]) -> Iterator[tuple[int, FloatArray, tuple[int, ...]]]:
    """Yield index, pose in the scene, and ancestors of each node with a mesh."""
    nodes = document.get("nodes", [])
    scenes = document.get("scenes", [])
    if scenes:
        roots = scenes[int(document.get("scene", 0))].get("nodes", [])
    else:
        below = {child for node in nodes for child in node.get("children", ())}
        roots = [index for index in range(len(nodes)) if index not in below]
    left: list[tuple[int, FloatArray, tuple[int, ...]]]
    left = [(int(index), np.eye(4), ()) for index in reversed(roots)]
    while left:
        index, T_parent, above = left.pop()
        node = nodes[index]
        T = T_parent @ _pose(node)
        if "mesh" in node:
            yield index, T, above
        children = reversed(node.get("children", ()))
        left.extend((int(child), T, (*above, index)) for child in children)


def _pose(node: Mapping[str, Any]) -> FloatArray:
    if "matrix" in node:
        T = np.array(node["matrix"], np.float64).reshape(4, 4).T
        if not np.allclose(T[3], (0, 0, 0, 1), rtol=0, atol=1e-6):
            raise ValueError("a node's matrix must end with 0, 0, 0, 1 in its last row")
        return T
    T = np.eye(4)
    R = scipy.spatial.transform.Rotation.from_quat(
        np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    ).as_matrix()
    T[:3, :3] = R * np.array(node.get("scale", (1, 1, 1)), np.float64)
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T


def _name(document: Mapping[str, Any], index: int) -> str:
    node = document["nodes"][index]
    mesh = document["meshes"][node["mesh"]] if "mesh" in node else {}
    return str(node.get("name") or mesh.get("name") or f"node {index}")


def _is_named(
    document: Mapping[str, Any], node: tuple[int, FloatArray, tuple[int, ...]], name: str | None
) -> bool:
    """Return whether a node, its mesh, or a node above it has a name."""
    index, _, above = node
    if name is None:
        return True
    mesh = document["meshes"][document["nodes"][index]["mesh"]]
    names = {_name(document, each) for each in (index, *above)} | {str(mesh.get("name"))}
    return name in names


def _check_size(
    document: Mapping[str, Any], nodes: Sequence[tuple[int, FloatArray, tuple[int, ...]]]
) -> None:
    """Raise if the instances of meshes have too many triangles."""
    corners = 0
    for index, _, _ in nodes:
        for primitive in document["meshes"][document["nodes"][index]["mesh"]]["primitives"]:
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

    def of_node(self, index: int, T: FloatArray) -> Iterator[LoadedMesh]:
        """Yield the surfaces of a node's mesh, at its pose."""
        mesh = self._document["meshes"][self._document["nodes"][index]["mesh"]]
        for primitive in mesh["primitives"]:
            mode = int(primitive.get("mode", TRIANGLES))
            if mode in (TRIANGLES, STRIP, FAN) and "POSITION" in primitive["attributes"]:
                yield self._surface(_name(self._document, index), primitive, mode, T)

    def _surface(
        self, name: str, primitive: Mapping[str, Any], mode: int, T: FloatArray
    ) -> LoadedMesh:
        attributes = primitive["attributes"]
        vertices = self._accessors.floats(int(attributes["POSITION"]))
        if vertices.shape[1] != 3:
            raise ValueError("POSITION must be of VEC3")
        order = np.arange(len(vertices))
        if "indices" in primitive:
            order = self._accessors.integers(int(primitive["indices"]))
        triangles = _triangles(order, mode)
        if np.linalg.det(T[:3, :3]) < 0:
            triangles = np.ascontiguousarray(triangles[:, ::-1])
        if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            raise ValueError("indices without vertices")
        base = self._materials.base_color(primitive.get("material"))
        uv = None
        if f"TEXCOORD_{base.uv_set}" in attributes:
            at = self._accessors.floats(int(attributes[f"TEXCOORD_{base.uv_set}"]))
            at = transform_uv(at, base.transform)
            uv = np.stack((at[:, 0], 1 - at[:, 1]), axis=1).astype(np.float32)[triangles]
        colors = None
        if "COLOR_0" in attributes:
            colors = encode_srgb(self._accessors.floats(int(attributes["COLOR_0"]))[:, :3])
        return LoadedMesh(
            name=name,
            vertices_m=transform_points(T, vertices),
            triangles=triangles,
            uv=uv,
            vertex_colors_srgb=colors,
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
    unused = set(materials.unused)
    primitives = [each for mesh in document.get("meshes", ()) for each in mesh["primitives"]]
    if any("targets" in each for each in primitives):
        unused.add("morph targets")
    unused |= {what for what in ("skins", "animations", "cameras") if document.get(what)}
    if unused:
        LOG.info("%s: not used: %s", path, ", ".join(sorted(unused)))
