"""What the server and its worker say to each other, over a socket pair.

A message is a JSON object and a list of arrays. No pickles: the two sides may be different Python
versions with different numpy versions. Many bytes go through shared memory whose descriptor is
passed along, so that a frame is copied once, by the worker, and never through the socket.
Must not import gRPC.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import socket
import struct
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core import types
from oaisys_grpc.shared_memory import SHARED_FROM_BYTES, Segment, SegmentWriter, layout

AnyArray = NDArray[Any]
Message = dict[str, Any]

_PREFIX = struct.Struct("<QQ?")
"""Bytes of the JSON, bytes of the arrays, and whether these are in shared memory."""

_RECORDS = {
    record.__name__: record
    for record in (
        types.Frame,
        types.FrameName,
        types.HeightQuery,
        types.ModuleMetadata,
        types.PinholeIntrinsics,
        types.Pose,
        types.Provenance,
        types.Sample,
        types.SampleOutline,
        types.SensorInfo,
        types.SimulatorInfo,
        types.TriangleMesh,
    )
}

_FIELDS = {
    record: tuple(field.name for field in dataclasses.fields(record))
    for record in _RECORDS.values()
    if dataclasses.is_dataclass(record)
}
_PLAIN = frozenset({str, int, float, bool, type(None)})


class Connection:
    """One end of the socket pair; any thread may send, one thread receives."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        self._sending = threading.Lock()
        self._segments = SegmentWriter()

    def fileno(self) -> int:
        """Return the descriptor, to wait on."""
        return self._socket.fileno()

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message of JSON-able values, arrays, and the core's records.

        Raises:
            OSError: The other end is gone.
        """
        arrays: list[AnyArray] = []
        encoded = _encoded(message, arrays)
        raws = [np.ascontiguousarray(a).reshape(-1).view(np.uint8) for a in arrays]
        shared = sum(raw.size for raw in raws) >= SHARED_FROM_BYTES
        with self._sending:
            if shared:
                self._send_shared(encoded, arrays, raws)
            else:
                begins, size = layout([raw.size for raw in raws])
                text = _text(encoded, arrays, begins)
                inline = _inline(raws, begins, size)
                self._socket.sendall(_PREFIX.pack(len(text), size, shared) + text + inline)

    def receive(self) -> Message:
        """Wait for the next message.

        Raises:
            EOFError: The other end is gone.
        """
        prefix, descriptors = self._read_prefix()
        text_size, arrays_size, shared = _PREFIX.unpack(prefix)
        content = json.loads(self._read(text_size))
        memory: Any = b""
        if shared:
            memory = Segment(descriptors[0], arrays_size)
        elif arrays_size:
            memory = self._read(arrays_size)
        arrays = [_array(memory, header) for header in content["arrays"]]
        decoded: Message = _decoded(content["value"], arrays)
        return decoded

    def close(self) -> None:
        """Close this end, which ends the other's `receive`."""
        self._socket.close()
        with self._sending:
            self._segments.close()

    def _send_shared(self, encoded: Any, arrays: list[AnyArray], raws: list[AnyArray]) -> None:
        descriptor, begins, size = self._segments.write(raws)
        try:
            text = _text(encoded, arrays, begins)
            content = _PREFIX.pack(len(text), size, True) + text
            sent = socket.send_fds(self._socket, [content], [descriptor])
        finally:
            os.close(descriptor)
        self._socket.sendall(content[sent:])
        self._segments.prepare()

    def _read_prefix(self) -> tuple[bytes, list[int]]:
        try:
            data, descriptors, _, _ = socket.recv_fds(self._socket, _PREFIX.size, 1)
        except OSError as error:
            raise EOFError(str(error)) from error
        if not data:
            raise EOFError("the connection was closed")
        return data + self._read(_PREFIX.size - len(data)), descriptors

    def _read(self, size: int) -> bytes:
        data = bytearray(size)
        view = memoryview(data)
        while view:
            try:
                count = self._socket.recv_into(view)
            except OSError as error:
                raise EOFError(str(error)) from error
            if not count:
                raise EOFError("the connection was closed within a message")
            view = view[count:]
        return bytes(data)


def _text(encoded: Any, arrays: list[AnyArray], begins: list[int]) -> bytes:
    headers = [
        {"dtype": array.dtype.str, "shape": array.shape, "begin": begin}
        for array, begin in zip(arrays, begins, strict=True)
    ]
    return json.dumps({"value": encoded, "arrays": headers}).encode()


def _inline(raws: list[AnyArray], begins: list[int], size: int) -> bytes:
    content = np.zeros(size, dtype=np.uint8)
    for begin, raw in zip(begins, raws, strict=True):
        content[begin : begin + raw.size] = raw
    return content.tobytes()


def _array(memory: Any, header: Message) -> AnyArray:
    shape = tuple(header["shape"])
    count = math.prod(shape)
    if not count:
        return np.empty(shape, header["dtype"])
    array = np.frombuffer(memory, header["dtype"], count, header["begin"])
    return array.reshape(shape)


def _encoded(value: Any, arrays: list[AnyArray]) -> Any:
    """Return the value as JSON, its arrays by their place in ``arrays``."""
    kind = type(value)
    if kind in _PLAIN:
        return value
    if kind is dict:
        if all(type(key) is str for key in value):
            return {"$mapping": {key: _encoded(inner, arrays) for key, inner in value.items()}}
        return {"$pairs": [[_encoded(k, arrays), _encoded(v, arrays)] for k, v in value.items()]}
    if kind is list:
        return [_encoded(inner, arrays) for inner in value]
    if kind in _FIELDS:
        fields = [_encoded(getattr(value, name), arrays) for name in _FIELDS[kind]]
        return {"$record": kind.__name__, "fields": fields}
    if isinstance(value, tuple):
        return {"$tuple": [_encoded(inner, arrays) for inner in value]}
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"$array": len(arrays) - 1}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return _encoded(dict(value), arrays)
    return value


def _decoded(value: Any, arrays: list[AnyArray]) -> Any:
    """Return what `_encoded` was given."""
    kind = type(value)
    if kind is list:
        return [_decoded(inner, arrays) for inner in value]
    if kind is not dict:
        return value
    if "$mapping" in value:
        return {key: _decoded(inner, arrays) for key, inner in value["$mapping"].items()}
    if "$record" in value:
        return _RECORDS[value["$record"]](*[_decoded(inner, arrays) for inner in value["fields"]])
    if "$tuple" in value:
        return tuple([_decoded(inner, arrays) for inner in value["$tuple"]])
    if "$array" in value:
        return arrays[value["$array"]]
    return {_decoded(k, arrays): _decoded(v, arrays) for k, v in value["$pairs"]}
