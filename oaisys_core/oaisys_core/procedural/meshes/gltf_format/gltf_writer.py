"""Writes meshes as binary glTF 2.0 with their base colours, which other programs open, too."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.files.whole_files import write_whole_bytes
from oaisys_core.procedural.meshes.loaded import LoadedMesh, plain_material
from oaisys_core.scene import MeshMaterial

WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
FLOAT, ARRAY_BUFFER = 5126, 34962
OPAQUE = 255.0


def write_glb(path: Path, mesh: LoadedMesh) -> None:
    """Write a mesh, z up, as .glb, y up; each material becomes a primitive.

    Raises:
        OSError: The file cannot be written.
    """
    document = _Document()
    for index, material in enumerate(mesh.materials or (plain_material(mesh),)):
        chosen = slice(None) if mesh.material_of is None else mesh.material_of == index
        document.add_primitive(mesh, chosen, material)
    write_whole_bytes(path, document.content(mesh.name))


class _Document:
    """The JSON and the binary part of a file."""

    def __init__(self) -> None:
        self._binary = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []
        self._textures: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._primitives: list[dict[str, Any]] = []

    def add_primitive(
        self, mesh: LoadedMesh, chosen: slice | NDArray[np.bool_], material: MeshMaterial
    ) -> None:
        """Add the chosen triangles of a mesh, whose corners each have vertices of their own."""
        corners = mesh.triangles[chosen].ravel()
        if not len(corners):
            return
        x, y, z = mesh.vertices_m[corners].T
        attributes = {"POSITION": self._add_array(np.stack((x, z, -y), axis=1), "VEC3")}
        if mesh.uv is not None:
            u, v = mesh.uv[chosen].reshape(-1, 2).T
            attributes["TEXCOORD_0"] = self._add_array(np.stack((u, 1 - v), axis=1), "VEC2")
        if mesh.vertex_colors_srgb is not None:
            colors = linear(mesh.vertex_colors_srgb[corners] / OPAQUE)
            attributes["COLOR_0"] = self._add_array(colors, "VEC3")
        primitive = {"attributes": attributes, "material": self._add_material(material)}
        self._primitives.append(primitive)

    def content(self, name: str) -> bytes:
        """Return the bytes of the file, whose only node has the given name."""
        document = {
            "asset": {"version": "2.0", "generator": "oaisys"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": name, "mesh": 0}],
            "meshes": [{"name": name, "primitives": self._primitives}],
            "materials": self._materials,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._binary)}],
        }
        if self._images:
            document |= {
                "images": self._images,
                "textures": self._textures,
                "samplers": self._samplers,
            }
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(self._binary)
        head = struct.pack("<4sII", b"glTF", 2, size)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        return head + chunks + struct.pack("<I4s", len(self._binary), b"BIN\0") + self._binary

    def _add_view(self, data: bytes, **more: int) -> int:
        start = len(self._binary)
        self._binary += data + b"\0" * (-len(data) % 4)
        self._views.append({"buffer": 0, "byteOffset": start, "byteLength": len(data), **more})
        return len(self._views) - 1

    def _add_array(self, values: NDArray[Any], kind: str) -> int:
        data = np.ascontiguousarray(values, "<f4")
        accessor: dict[str, Any] = {
            "bufferView": self._add_view(data.tobytes(), target=ARRAY_BUFFER),
            "componentType": FLOAT,
            "count": len(data),
            "type": kind,
            "min": data.min(axis=0).tolist(),
            "max": data.max(axis=0).tolist(),
        }
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def _add_material(self, material: MeshMaterial) -> int:
        pbr: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        found: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": pbr}
        if material.color_image_srgb is not None or material.opacity is not None:
            pbr["baseColorTexture"] = {"index": self._add_texture(material)}
        if material.color_image_srgb is None:
            pbr["baseColorFactor"] = [*linear(np.array(material.color_srgb)).tolist(), 1.0]
        if material.opacity is not None:
            found |= {"alphaMode": "MASK", "alphaCutoff": material.cutoff / OPAQUE}
        self._materials.append(found)
        return len(self._materials) - 1

    def _add_texture(self, material: MeshMaterial) -> int:
        from PIL import Image

        colors, opacity = material.color_image_srgb, material.opacity
        if colors is None:
            assert opacity is not None
            colors = np.full((*opacity.shape, 3), OPAQUE, np.uint8)
        image = Image.fromarray(colors)
        if opacity is not None:
            # The finer of both sizes, so that neither edges nor colours are lost.
            alpha = Image.fromarray(opacity)
            size = max(image.size, alpha.size)
            image = image.resize(size) if image.size != size else image
            image.putalpha(alpha.resize(size) if alpha.size != size else alpha)
        data = io.BytesIO()
        image.save(data, "PNG")
        view = self._add_view(data.getvalue())
        self._images.append({"mimeType": "image/png", "bufferView": view})
        along_u, along_v = (WRAPS[each] for each in material.wrap)
        self._samplers.append({"wrapS": along_u, "wrapT": along_v})
        last = len(self._images) - 1
        self._textures.append({"source": last, "sampler": last})
        return last
