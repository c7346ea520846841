"""Base colours of glTF materials (glTF 2.0, §3.9.2), and where alpha cuts them out (§3.9.4)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import srgb
from oaisys_core.errors import quote
from oaisys_core.procedural.meshes.cut_outs import cut_out
from oaisys_core.procedural.meshes.gltf_format.gltf_accessors import Accessors, data_of_uri
from oaisys_core.procedural.meshes.loaded import decode_texture, multiply_image
from oaisys_core.scene import MeshMaterial, Wrap
from oaisys_core.types import FloatArray

LOG = logging.getLogger(__name__)

WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}

DEFAULT = MeshMaterial("default")
"""That of primitives without one: white."""

SPECULAR = "KHR_materials_pbrSpecularGlossiness"
TRANSFORM = "KHR_texture_transform"

Image = tuple[NDArray[np.uint8], NDArray[np.uint8] | None]


class BaseColor(NamedTuple):
    """A material, and how its image lies on a mesh.

    Attributes:
        material: Its colours.
        uv_set: Number of the texture coordinates.
        transform: (2, 3) affine transform of these.
    """

    material: MeshMaterial
    uv_set: int
    transform: FloatArray


class GltfMaterials:
    """The materials of a document, each image decoded once.

    Args:
        document: The file's JSON, checked.
        accessors: Of the document.
        get: Returns the content, checked, of the image file of a relative URI; None: it is missing.
        name: Name of the file in warnings.
    """

    def __init__(
        self,
        document: Mapping[str, Any],
        accessors: Accessors,
        get: Callable[[str], bytes | None],
        name: str,
    ) -> None:
        self._document, self._accessors, self._get = document, accessors, get
        self._name = name
        self._images: dict[int, Image | None] = {}
        self._found: dict[int, BaseColor] = {}
        self.unused: set[str] = set()
        """What the materials say and nobody uses."""

    def base_color(self, index: int | None) -> BaseColor:
        """Return a material by its index; None: that of primitives without one."""
        if index is None:
            return BaseColor(DEFAULT, 0, np.eye(2, 3))
        if index not in self._found:
            self._found[index] = self._read(index)
        return self._found[index]

    def _read(self, index: int) -> BaseColor:
        material = self._document["materials"][index]
        name = str(material.get("name", f"material {index}"))
        pbr = material.get("pbrMetallicRoughness", {})
        texture, factor = pbr.get("baseColorTexture"), pbr.get("baseColorFactor")
        older = material.get("extensions", {}).get(SPECULAR)
        if older is not None and texture is None and factor is None:
            texture, factor = older.get("diffuseTexture"), older.get("diffuseFactor")
        self._note_unused(material, pbr)
        linear_rgba = np.array(factor if factor is not None else (1, 1, 1, 1), np.float64)
        if linear_rgba.shape != (4,) or not (abs(linear_rgba - 0.5) <= 0.501).all():
            shown = quote(factor)
            raise ValueError(f"a base colour of four numbers from 0 to 1, not {shown}: {name!r}")
        linear_rgba = linear_rgba.clip(0, 1)
        image = self._image_of(texture) if texture is not None else None
        mode = material.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise ValueError(f"an alphaMode of OPAQUE, MASK or BLEND, not {quote(mode)}: {name!r}")
        opacity, cutoff = None, 0.5
        if mode in ("MASK", "BLEND"):
            cutoff = float(material.get("alphaCutoff", 0.5)) if mode == "MASK" else 0.5
            alpha = image[1] if image is not None else None
            where = f"{self._name}: material {name!r}"
            opacity = cut_out(alpha, linear_rgba[3], cutoff, where, is_mask=mode == "MASK")
        red, green, blue = srgb(linear_rgba[:3]).tolist()
        colors = None if image is None else multiply_image(image[0], linear_rgba[:3])
        # Of the image alone, before the factor.
        least = 255 * min(cutoff / max(linear_rgba[3], 1e-9), 2.0)
        wrap = self._wrap(texture)
        found = MeshMaterial(name, (red, green, blue), colors, opacity, least, wrap)
        return BaseColor(found, *_place(texture or {}))

    def _image_of(self, texture: Mapping[str, Any]) -> Image | None:
        entry = self._document["textures"][int(texture["index"])]
        more = entry.get("extensions", {})
        source = entry.get("source")
        for extension in ("EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds"):
            if source is None and extension in more:
                source = more[extension].get("source")
        if source is None:
            LOG.warning("%s: a texture without an image that can be read", self._name)
            return None
        if int(source) not in self._images:
            self._images[int(source)] = self._decode(int(source))
        return self._images[int(source)]

    def _decode(self, source: int) -> Image | None:
        image = self._document["images"][source]
        if "bufferView" in image:
            data: bytes | None = self._accessors.view(int(image["bufferView"]))
        else:
            uri = str(image.get("uri", ""))
            data = data_of_uri(uri) or self._get(uri)
        return None if data is None else decode_texture(data, f"{self._name}: image {source}")

    def _wrap(self, texture: Mapping[str, Any] | None) -> tuple[Wrap, Wrap]:
        if texture is None:
            return ("repeat", "repeat")
        entry = self._document["textures"][int(texture["index"])]
        sampler: Mapping[str, Any] = {}
        if "sampler" in entry:
            sampler = self._document["samplers"][int(entry["sampler"])]
        along = [WRAPS.get(sampler.get(key, 10497), "repeat") for key in ("wrapS", "wrapT")]
        return along[0], along[1]

    def _note_unused(self, material: Mapping[str, Any], pbr: Mapping[str, Any]) -> None:
        names = {
            "metallic and roughness": {"metallicFactor", "roughnessFactor"} & pbr.keys()
            or "metallicRoughnessTexture" in pbr,
            "normal maps": "normalTexture" in material,
            "occlusion": "occlusionTexture" in material,
            "emission": "emissiveTexture" in material or any(material.get("emissiveFactor", ())),
        }
        self.unused |= {name for name, is_there in names.items() if is_there}
        extensions = material.get("extensions", {}).keys() - {SPECULAR, "KHR_materials_unlit"}
        self.unused |= set(map(str, extensions))


def _place(texture: Mapping[str, Any]) -> tuple[int, FloatArray]:
    """Return the number of the texture coordinates, and their (2, 3) transform."""
    transform = texture.get("extensions", {}).get(TRANSFORM, {})
    uv_set = int(transform.get("texCoord", texture.get("texCoord", 0)))
    angle = float(transform.get("rotation", 0.0))
    x, y = (float(value) for value in transform.get("scale", (1.0, 1.0)))
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.array([(cos * x, sin * y), (-sin * x, cos * y)])
    offset = np.array(transform.get("offset", (0.0, 0.0)), np.float64)
    return uv_set, np.column_stack((matrix, offset))
