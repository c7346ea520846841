"""What the server and its worker say to each other, over a socket pair.

A message is a JSON object and a list of arrays. No pickles: the two sides may be different Python
versions with different numpy versions. Many bytes go through shared
memory whose descriptor is passed along (`oaisys_grpc.worker.frame_packing`), so that a frame is
copied once, by the worker, and never through the socket.
Must not import gRPC.
"""

from __future__ import annotations

import dataclasses
import json
import os
import socket
import struct
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from oaisys_core import types
from oaisys_grpc.worker.frame_packing import MAX_FILES, AnyArray, load, unload
from oaisys_grpc.worker.shared_memory import Segment, SegmentWriter

Message = dict[str, Any]

_PREFIX = struct.Struct("<QQB")
"""Bytes of the JSON, bytes of the arrays that follow it, and how many files go along."""

_RECORDS = {
    record.__name__: record
    for record in (
        types.Frame,
        types.FrameName,
        types.HeightGrid,
        types.HeightQuery,
        types.ModuleMetadata,
        types.ObjectPage,
        types.ObjectQuery,
        types.Odometry,
        types.PinholeIntrinsics,
        types.Pose,
        types.Provenance,
        types.Sample,
        types.SampleOutline,
        types.SceneObject,
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
        with self._sending:
            cargo = load(arrays, self._segments)
            text = json.dumps({"value": encoded, "arrays": cargo.headers}).encode()
            head = _PREFIX.pack(len(text), len(cargo.inline), len(cargo.files))
            content, sent = b"".join((head, text, cargo.inline)), 0
            if cargo.files:
                descriptors = [file.descriptor for file in cargo.files]
                sent = socket.send_fds(self._socket, [content], descriptors)
            self._socket.sendall(content[sent:])
            self._segments.prepare()

    def receive(self) -> Message:
        """Wait for the next message.

        Raises:
            EOFError: The other end is gone.
        """
        prefix, descriptors = self._read_prefix()
        text_size, inline_size, count = _PREFIX.unpack(prefix)
        files = [Segment(each, os.fstat(each).st_size) for each in descriptors]
        content = json.loads(self._read(text_size))
        inline = self._read(inline_size) if inline_size else b""
        if len(files) != count:
            raise EOFError(f"{len(files)} of {count} files came with a message")
        arrays = unload(content["arrays"], files, inline)
        decoded: Message = _decoded(content["value"], arrays)
        return decoded

    def close(self) -> None:
        """Close this end, which ends the other's `receive`."""
        self._socket.close()
        with self._sending:
            self._segments.close()

    def _read_prefix(self) -> tuple[bytes, list[int]]:
        try:
            data, descriptors, _, _ = socket.recv_fds(self._socket, _PREFIX.size, MAX_FILES)
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
