"""Arrays as headers and bytes, raw or losslessly encoded, whole or in chunks; in pairs."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.types import MAX_IMAGE_PX
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

AnyArray = NDArray[Any]
Raw = NDArray[np.uint8]

CHUNK_BYTES = 1 << 20
"""For a client that says nothing."""

MAX_FRAME_BYTES = 12 * MAX_IMAGE_PX
"""The largest image with three floats a pixel."""

_DTYPES: dict[int, np.dtype[Any]] = {
    pb.DATA_TYPE_UINT8: np.dtype("<u1"),
    pb.DATA_TYPE_UINT16: np.dtype("<u2"),
    pb.DATA_TYPE_UINT32: np.dtype("<u4"),
    pb.DATA_TYPE_INT32: np.dtype("<i4"),
    pb.DATA_TYPE_FLOAT32: np.dtype("<f4"),
    pb.DATA_TYPE_FLOAT64: np.dtype("<f8"),
}
_DATA_TYPES: dict[np.dtype[Any], Any] = {dtype: data_type for data_type, dtype in _DTYPES.items()}

_FAST = 1
"""Compression level of zlib; higher ones take several times as long for a few per cent."""


class Codec(NamedTuple):
    """One encoding: ``encode`` returns None where it cannot hold an array."""

    encoded: Callable[[AnyArray], bytes | None]
    decoded: Callable[[bytes, np.dtype[Any], tuple[int, ...]], AnyArray]


def data_type_of(dtype: np.dtype[Any]) -> pb.DataType.ValueType:
    """Return the contract's value of a data type; inverse: `dtype_of`."""
    data_type: pb.DataType.ValueType = _DATA_TYPES[dtype]
    return data_type


def dtype_of(data_type: int) -> np.dtype[Any]:
    """Return a data type.

    Raises:
        OaisysError: It is unknown.
    """
    if data_type not in _DTYPES:
        raise OaisysError(f"cannot read the data type {data_type}")
    return _DTYPES[data_type]


def encode(array: AnyArray, accepted: Iterable[int]) -> tuple[pb.ArrayHeader, Raw]:
    """Return an array's header and bytes, in the first accepted encoding that makes it smaller.

    If none does, the bytes are the array's own memory. Inverse: `decode`.
    """
    array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    header = raw_header(array)
    for encoding in accepted:
        codec = CODECS.get(encoding)
        data = codec.encoded(array) if codec and array.size else None
        if data is not None and len(data) < array.nbytes:
            header.encoding, header.byte_size = pb.Encoding.ValueType(encoding), len(data)
            return header, np.frombuffer(data, np.uint8)
    return header, array.reshape(-1).view(np.uint8)


def raw_header(array: AnyArray) -> pb.ArrayHeader:
    """Return the header of an array whose bytes stay as they are."""
    return raw_header_of(array.dtype, array.shape)


def raw_header_of(dtype: np.dtype[Any], shape: tuple[int, ...]) -> pb.ArrayHeader:
    """Return the header of an array of some type and shape whose bytes stay as they are."""
    return pb.ArrayHeader(
        data_type=_DATA_TYPES[dtype],
        shape=shape,
        encoding=pb.ENCODING_RAW,
        byte_size=math.prod(shape) * dtype.itemsize,
    )


def decode(header: pb.ArrayHeader, data: Raw) -> AnyArray:
    """Return the array of a header that `check_nbytes` passed; raw bytes are not copied.

    Raises:
        OaisysError: The bytes are not what the header says.
    """
    dtype, shape = _DTYPES[header.data_type], tuple(header.shape)
    if header.encoding == pb.ENCODING_RAW:
        return data.view(dtype).reshape(shape)
    return CODECS[header.encoding].decoded(data.tobytes(), dtype, shape)


def check_nbytes(header: pb.ArrayHeader, limit: int) -> int:
    """Check an array's header and return the array's decoded size in bytes.

    Raises:
        OaisysError: The header contradicts itself, exceeds the limit, or has an unknown data type
            or encoding.
    """
    dtype = _DTYPES.get(header.data_type)
    if dtype is None or header.encoding not in (pb.ENCODING_RAW, *CODECS):
        raise OaisysError(
            f"cannot read an array of data type {header.data_type}, encoding {header.encoding}"
        )
    nbytes = math.prod(header.shape) * dtype.itemsize
    if nbytes > limit:
        raise OaisysError(
            f"shape {list(header.shape)} takes {nbytes} bytes: this client takes {limit} at most"
        )
    if header.byte_size != nbytes and (
        header.encoding == pb.ENCODING_RAW or header.byte_size > nbytes
    ):
        raise OaisysError(f"shape {list(header.shape)} is not {header.byte_size} bytes")
    return nbytes


class ArrayAssembly:
    """Puts an array together from its header and its chunks, in one allocation.

    Attributes:
        nbytes: Of the array, decoded.
    """

    def __init__(self, header: pb.ArrayHeader, limit: int = MAX_FRAME_BYTES) -> None:
        """Check the header and allocate.

        Args:
            limit: Most bytes that the array may have, decoded.

        Raises:
            OaisysError: The header contradicts itself, or says what this client cannot read.
        """
        self.nbytes = check_nbytes(header, limit)
        self._header = header
        self._bytes = np.empty(header.byte_size, dtype=np.uint8)
        self._received = 0

    def add(self, chunk: pb.Chunk) -> None:
        """Take the next piece.

        Raises:
            OaisysError: It does not follow the piece before, or runs over the end.
        """
        end = chunk.offset + len(chunk.data)
        if chunk.offset != self._received or end > self._bytes.size:
            raise OaisysError(f"a chunk is out of order: offset {chunk.offset}")
        self._bytes[chunk.offset : end] = np.frombuffer(chunk.data, dtype=np.uint8)
        self._received = end

    @property
    def is_complete(self) -> bool:
        """Whether all pieces have come."""
        return self._received == self._bytes.size

    def array(self) -> AnyArray:
        """Return the array.

        Raises:
            OaisysError: Pieces are missing, or cannot be decoded.
        """
        if not self.is_complete:
            raise OaisysError(f"{self._received} of {self._bytes.size} bytes came")
        return decode(self._header, self._bytes)


def array_chunks(
    data: NDArray[np.uint8], index: int, size: int = CHUNK_BYTES, *, begin: int = 0
) -> Iterator[pb.Chunk]:
    """Yield an encoded array's bytes in pieces; inverse: `ArrayAssembly`.

    Args:
        data: The bytes, or some of them.
        index: The array's number in its message.
        size: Bytes of a piece.
        begin: Bytes of the array before the first one here.
    """
    for first in range(0, data.size, size):
        piece = data[first : first + size].tobytes()
        yield pb.Chunk(index=index, offset=begin + first, data=piece)


def _to_png(array: AnyArray) -> bytes | None:
    """Return an image as a PNG file; None if the contract has none for its kind."""
    image = _png_image(array)
    if image is None:
        return None
    made, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, _FAST])
    return data.tobytes() if made else None


def _png_image(array: AnyArray) -> AnyArray | None:
    """Return an image with its channels in OpenCV's order: blue, green, red."""
    if array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] == 3:
        return array[..., ::-1]
    if array.dtype in (np.uint8, np.uint16) and array.ndim == 2:
        return array
    if array.dtype == np.uint32 and array.ndim == 2:
        return array.view(np.uint8).reshape(*array.shape, 4)[..., [2, 1, 0, 3]]
    return None


def _from_png(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> AnyArray:
    expected = _PNG_KINDS.get((dtype.str, shape[2:]))
    if expected is None or len(shape) < 2 or _png_header(data) != (shape[1], shape[0], *expected):
        raise OaisysError(f"the PNG file is no image of shape {list(shape)}, {dtype.name}")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise OaisysError("the PNG file is damaged")
    if dtype == np.uint32:
        ids = np.ascontiguousarray(image[..., [2, 1, 0, 3]])
        return ids.view(dtype).reshape(shape)
    array: AnyArray = image[..., ::-1] if len(shape) == 3 else image
    return np.ascontiguousarray(array, dtype)


_PNG_START = struct.Struct(">8sI4sIIBB")

_PNG_KINDS = {
    ("|u1", (3,)): (8, 2),
    ("|u1", ()): (8, 0),
    ("<u2", ()): (16, 0),
    ("<u4", ()): (8, 6),
}
"""Bits and colour type in the PNG header, by data type and channels."""


def _png_header(data: bytes) -> tuple[int, ...]:
    """Return width, height, bits and colour type, which decoding allocates for; () if damaged."""
    if len(data) < _PNG_START.size:
        return ()
    signature, _, kind, *header = _PNG_START.unpack_from(data)
    return tuple(header) if (signature, kind) == (b"\x89PNG\r\n\x1a\n", b"IHDR") else ()


def _to_shuffled_zlib(array: AnyArray) -> bytes:
    """Return the first bytes of all elements, then the second bytes and so on, compressed.

    The upper bytes of neighbouring depths are alike; the lower ones are nearly noise.
    """
    planes = array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T
    return zlib.compress(np.ascontiguousarray(planes).data, _FAST)


def _from_shuffled_zlib(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> AnyArray:
    nbytes = math.prod(shape) * dtype.itemsize
    decompressor = zlib.decompressobj()
    try:
        planes = decompressor.decompress(data, nbytes + 1)
    except zlib.error as error:
        raise OaisysError(f"the zlib stream is damaged: {error}") from error
    if len(planes) != nbytes or not decompressor.eof or decompressor.unused_data:
        raise OaisysError(f"the zlib stream does not hold {nbytes} bytes")
    elements = np.frombuffer(planes, np.uint8).reshape(dtype.itemsize, -1).T
    return np.ascontiguousarray(elements).reshape(-1).view(dtype).reshape(shape)


CODECS: dict[int, Codec] = {
    pb.ENCODING_PNG: Codec(_to_png, _from_png),
    pb.ENCODING_SHUFFLED_ZLIB: Codec(_to_shuffled_zlib, _from_shuffled_zlib),
}
"""All encodings but raw."""

_NAMES: dict[str, int] = {"png": pb.ENCODING_PNG, "shuffled_zlib": pb.ENCODING_SHUFFLED_ZLIB}


def encodings_from_names(names: Sequence[str]) -> tuple[int, ...]:
    """Return the contract's values of ``png`` and ``shuffled_zlib``.

    Raises:
        InvalidInputError: There is no such encoding.
    """
    for name in names:
        if name not in _NAMES:
            raise InvalidInputError("encodings", name, " or ".join(_NAMES))
    return tuple(_NAMES[name] for name in names)
