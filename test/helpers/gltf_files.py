"""Small glTF files, written number by number."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

TYPES = {"float32": 5126, "uint8": 5121, "uint16": 5123, "uint32": 5125, "int8": 5120}
SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float32)
"""A square in the plane z = 0 of the file, which is y = 0 once it is turned: it faces -y."""

UV = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], np.float32)
"""So that the image stands upright on the square: v of glTF points down."""

CORNERS = np.array([0, 1, 2, 0, 2, 3], np.uint16)


class GltfFile:
    """A document that grows by primitives of one mesh."""

    def __init__(self) -> None:
        self._data = b""
        self._primitives: list[dict[str, Any]] = []
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": "thing"}],
            "meshes": [{"primitives": self._primitives}],
            **{name: [] for name in ("bufferViews", "accessors", "materials", "textures")},
            "images": [],
        }

    def accessor(self, values: ArrayLike, *, normalized: bool = False) -> int:
        """Add (N, C) or (N,) numbers and return their index."""
        array = np.ascontiguousarray(values)
        self._data += b"\0" * (-len(self._data) % 4)
        view = {"buffer": 0, "byteOffset": len(self._data), "byteLength": array.nbytes}
        self._data += array.tobytes()
        self.document["bufferViews"].append(view)
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        entry = {
            "bufferView": len(self.document["bufferViews"]) - 1,
            "componentType": TYPES[array.dtype.name],
            "count": len(array),
            "type": kind,
        }
        self.document["accessors"].append(entry | ({"normalized": True} if normalized else {}))
        return len(self.document["accessors"]) - 1

    def square(
        self,
        material: dict[str, Any] | None = None,
        at: Sequence[float] = (0, 0, 0),
        uv: NDArray[Any] = UV,
        **attributes: int,
    ) -> None:
        """Add a square with a material and further attributes."""
        own = {"POSITION": self.accessor(SQUARE + np.array(at, np.float32))}
        own["TEXCOORD_0"] = self.accessor(uv)
        primitive: dict[str, Any] = {"attributes": own | attributes}
        primitive["indices"] = self.accessor(CORNERS)
        if material is not None:
            self.document["materials"].append(material)
            primitive["material"] = len(self.document["materials"]) - 1
        self._primitives.append(primitive)

    def texture(self, pixels: NDArray[np.uint8], **more: Any) -> dict[str, Any]:
        """Add an image, row 0 on top, and return how a material refers to it."""
        data = io.BytesIO()
        Image.fromarray(pixels).save(data, "PNG")
        uri = "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()
        self.document["images"].append({"uri": uri})
        self.document["textures"].append({"source": len(self.document["images"]) - 1} | more)
        return {"index": len(self.document["textures"]) - 1}

    def save(self, path: Path, **more: Any) -> Path:
        """Write the file, with further parts of the document."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(self._data).decode()
        buffers = [{"byteLength": len(self._data), "uri": uri}]
        path.write_text(json.dumps(self.document | {"buffers": buffers} | more))
        return path


def base_color(**values: Any) -> dict[str, Any]:
    """Return a material of a base colour."""
    return {"pbrMetallicRoughness": values}
