"""What the server and its worker say to each other, over a socket pair.

A message has a head, which is JSON, one of the contract's messages, and arrays of bytes that it
describes. Large arrays go through shared memory whose descriptor is passed along, so that a frame
is copied once, by the worker, and never through the socket. There are no pickles: the two sides may
have different versions of Python and numpy. Must not import gRPC.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_grpc.contract.arrays import AnyArray
from oaisys_grpc.contract.shared_memory import (
    SHARED_FROM_BYTES,
    Segment,
    segment_of,
    share_if_possible,
)

_PREFIX = struct.Struct("<QQQB")
"""Bytes of the head, of the contract's message and of the inline arrays; number of segments."""

_MAX_SEGMENTS = 200
"""Of one message (Linux passes 253 descriptors); arrays in more than these are copied."""

_INLINE = -1
_ALIGNMENT = 16

ArrayLocation = tuple[int, int, int]
"""Of an array: its segment's number or `_INLINE`, its offset there, and its size in bytes."""


class WorkerMessage(NamedTuple):
    """One message between server and worker.

    Attributes:
        head: JSON-able. ``type``: ``call``, ``cancel`` or ``end`` from the server; ``progress``,
            ``info``, ``frames`` or ``answer`` from the worker. ``id``: the call's number.
        content: The serialized message of the contract that the type implies.
        arrays: uint8 arrays that the content describes, in its order.
    """

    head: dict[str, Any]
    content: bytes = b""
    arrays: Sequence[NDArray[np.uint8]] = ()

    @property
    def type(self) -> str:
        """See `head`."""
        return str(self.head["type"])


class Connection:
    """One end of the socket pair; any thread may send, one thread receives."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        self._sending = threading.Lock()

    def send(
        self, head: dict[str, Any], content: bytes = b"", arrays: Sequence[AnyArray] = ()
    ) -> None:
        """Send a `WorkerMessage`; its arrays may have any data type.

        Raises:
            OSError: The other end is gone.
        """
        places, segments, inline = _place(arrays)
        text = json.dumps({**head, "arrays": places}).encode()
        prefix = _PREFIX.pack(len(text), len(content), len(inline), len(segments))
        data, sent = b"".join((prefix, text, content, inline)), 0
        with self._sending:
            if segments:
                descriptors = [segment.descriptor for segment in segments]
                sent = socket.send_fds(self._socket, [data], descriptors)
            self._socket.sendall(data[sent:])

    def receive(self) -> WorkerMessage:
        """Wait for the next message; its arrays are not copied.

        Raises:
            EOFError: The other end is gone.
        """
        prefix, descriptors = self._read_prefix()
        head_size, content_size, inline_size, count = _PREFIX.unpack(prefix)
        segments = [Segment(each, os.fstat(each).st_size) for each in descriptors]
        head = json.loads(self._read(head_size))
        content, inline = self._read(content_size), self._read(inline_size)
        if len(segments) != count:
            raise EOFError(f"{len(segments)} of {count} segments came with a message")
        memory = (*segments, inline)
        arrays = [_bytes_at(memory[number], begin, size) for number, begin, size in head["arrays"]]
        return WorkerMessage(head, content, arrays)

    def close(self) -> None:
        """Close this end, which ends the other's `receive`."""
        self._socket.close()

    def _read_prefix(self) -> tuple[bytes, list[int]]:
        try:
            data, descriptors, _, _ = socket.recv_fds(self._socket, _PREFIX.size, _MAX_SEGMENTS)
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


def _place(arrays: Sequence[AnyArray]) -> tuple[list[ArrayLocation], list[Segment], bytes]:
    """Return where arrays travel.

    Arrays that lie in a segment stay there. The others go into a new one if they are large, else
    inline.

    Returns:
        Each array's place, the segments, and the inline bytes.
    """
    raws = [np.ascontiguousarray(array).reshape(-1).view(np.uint8) for array in arrays]
    loose = [number for number, raw in enumerate(raws) if segment_of(raw) is None]
    if sum(raws[number].size for number in loose) >= SHARED_FROM_BYTES:
        shared = share_if_possible([raws[number] for number in loose])
        for number, raw in zip(loose, shared or (), strict=shared is not None):
            raws[number] = raw
    segments: list[Segment] = []
    places: list[ArrayLocation] = []
    inline = bytearray()
    for raw in raws:
        segment = segment_of(raw)
        if segment is not None and segment not in segments and len(segments) < _MAX_SEGMENTS:
            segments.append(segment)
        if segment is not None and segment in segments:
            places.append((segments.index(segment), segment.offset_of(raw), raw.size))
        else:
            inline += bytes(-len(inline) % _ALIGNMENT)
            places.append((_INLINE, len(inline), raw.size))
            inline += raw.tobytes()
    return places, segments, bytes(inline)


def _bytes_at(memory: Segment | bytes, begin: int, size: int) -> NDArray[np.uint8]:
    return np.frombuffer(memory, np.uint8, size, begin) if size else np.empty(0, np.uint8)
