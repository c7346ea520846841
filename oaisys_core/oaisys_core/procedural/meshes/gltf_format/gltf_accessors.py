"""Arrays of numbers in glTF files: buffers, buffer views and accessors (glTF 2.0, §3.6)."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Accessors:
    """Reads the accessors of a document that `read_gltf` has checked.

    Args:
        document: The file's JSON.
        binary: The binary part of a .glb file.
        get: Returns the content of the file of a relative URI.
    """

    def __init__(
        self, document: Mapping[str, Any], binary: bytes, get: Callable[[str], bytes]
    ) -> None:
        self._document, self._binary, self._get = document, binary, get
        self._buffers: dict[int, bytes] = {}

    def integers(self, index: int) -> NDArray[np.int64]:
        """Return the (N,) integers of an accessor."""
        return self._values(index)[:, 0].astype(np.int64)

    def floats(self, index: int) -> FloatArray:
        """Return the (N, C) numbers of an accessor; normalised integers become -1 to 1."""
        values = self._values(index)
        found = values.astype(np.float64)
        if self._document["accessors"][index].get("normalized") and values.dtype.kind in "iu":
            found = np.maximum(found / np.iinfo(values.dtype).max, -1.0)
        return found

    def matrices(self, index: int) -> FloatArray:
        """Return the (N, 4, 4) matrices of an accessor, which stores their columns."""
        if self._document["accessors"][index]["type"] != "MAT4":
            raise ValueError(f"matrices of type MAT4 in accessor {index}")
        return self.floats(index).reshape(-1, 4, 4).transpose(0, 2, 1)

    def view(self, index: int) -> bytes:
        """Return the bytes of a buffer view."""
        view = self._document["bufferViews"][index]
        start = int(view.get("byteOffset", 0))
        data = self._buffer(int(view.get("buffer", 0)))[start : start + int(view["byteLength"])]
        if len(data) < int(view["byteLength"]):
            raise ValueError(f"buffer view {index} ends behind its buffer")
        return data

    def _values(self, index: int) -> NDArray[Any]:
        accessor = self._document["accessors"][index]
        count, width = int(accessor["count"]), COMPONENTS[accessor["type"]]
        dtype = np.dtype(TYPES[accessor["componentType"]])
        if "bufferView" in accessor:
            offset = int(accessor.get("byteOffset", 0))
            values = self._array(int(accessor["bufferView"]), offset, dtype, count, width)
        else:
            values = np.zeros((count, width), dtype)
        sparse = accessor.get("sparse")
        if sparse is not None:
            values = values.copy()
            number, where, what = int(sparse["count"]), sparse["indices"], sparse["values"]
            kind = np.dtype(TYPES[where["componentType"]])
            at = (int(where["bufferView"]), int(where.get("byteOffset", 0)))
            rows = self._array(*at, kind, number, 1)[:, 0].astype(np.int64)
            if len(rows) and rows.min() < 0:
                raise ValueError("sparse indices must be 0 or more")
            at = (int(what["bufferView"]), int(what.get("byteOffset", 0)))
            values[rows] = self._array(*at, dtype, number, width)
        return values

    def _array(
        self, view: int, offset: int, dtype: np.dtype[Any], count: int, width: int
    ) -> NDArray[Any]:
        data = self.view(view)
        stride = int(self._document["bufferViews"][view].get("byteStride", 0))
        stride = stride or width * dtype.itemsize
        end = offset + (count - 1) * stride + width * dtype.itemsize
        if stride < width * dtype.itemsize:
            raise ValueError(f"the elements of buffer view {view} overlap")
        if offset < 0 or end > len(data):
            raise ValueError(f"an accessor ends behind buffer view {view}")
        shape, strides = (count, width), (stride, dtype.itemsize)
        return np.ndarray(shape, dtype, data, offset, strides)

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            uri = self._document["buffers"][index].get("uri")
            if uri is None and index:
                raise ValueError(f"a uri of buffer {index}: only the first may be in the file")
            if uri is None:
                self._buffers[index] = self._binary
            else:
                self._buffers[index] = data_of_uri(str(uri)) or self._get(str(uri))
        return self._buffers[index]


def data_of_uri(uri: str) -> bytes | None:
    """Return the bytes in a data URI; None if it is not one."""
    return base64.b64decode(uri.partition(",")[2]) if uri.startswith("data:") else None
