"""A client of HTTP/2 that does what no library would: it begins far too many calls."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from typing import Self

_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
_DATA, _HEADERS, _RST_STREAM, _SETTINGS, _PING = 0, 1, 3, 4, 6
_ACK, _END_HEADERS = 0x1, 0x4
_FRAME_HEAD = 9
_BATCH = 100
_PATIENCE_S = 10.0


class RawConnection:
    """A connection to a server, a context manager; its frames are written by hand.

    Attributes:
        resets: How many of its calls the server ended so far.
    """

    def __init__(self, address: str) -> None:
        host, port = address.rsplit(":", 1)
        self._socket = socket.create_connection((host, int(port)), _PATIENCE_S)
        self._next_stream = 1
        self.resets = 0
        self._socket.sendall(_PREFACE + _frame(_SETTINGS, 0, 0))
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._reader.join(_PATIENCE_S)
        self._socket.close()

    def begin_calls(self, path: str, count: int, *metadata: tuple[str, bytes]) -> int:
        """Begin calls whose requests never come; return how many until the server hung up."""
        block = call_headers(path) + b"".join(header(name, value) for name, value in metadata)
        for begun in range(0, count, _BATCH):
            streams = [self._new_stream() for _ in range(min(_BATCH, count - begun))]
            frames = (_frame(_HEADERS, _END_HEADERS, stream, block) for stream in streams)
            try:
                self._socket.sendall(b"".join(frames))
            except OSError:
                return begun
        return count

    def send(self, stream: int, data: bytes) -> None:
        """Send bytes on a call."""
        self._socket.sendall(_frame(_DATA, 0, stream, data))

    def _new_stream(self) -> int:
        stream, self._next_stream = self._next_stream, self._next_stream + 2
        return stream

    def _read(self) -> None:
        """Answer what must be answered, until the server hangs up."""
        self._socket.settimeout(None)
        with contextlib.suppress(OSError), self._socket.makefile("rb") as received:
            while len(head := received.read(_FRAME_HEAD)) == _FRAME_HEAD:
                content = received.read(int.from_bytes(head[:3], "big"))
                kind, flags = head[3], head[4]
                self.resets += kind == _RST_STREAM
                if kind == _SETTINGS and not flags & _ACK:
                    self._socket.sendall(_frame(_SETTINGS, _ACK, 0))
                if kind == _PING and not flags & _ACK:
                    self._socket.sendall(_frame(_PING, _ACK, 0, content))


def call_headers(path: str) -> bytes:
    """Return the headers of a call of gRPC, as bytes."""
    fields = {
        ":method": "POST",
        ":scheme": "http",
        ":path": path,
        ":authority": "localhost",
        "content-type": "application/grpc",
        "te": "trailers",
    }
    return b"".join(header(name, value.encode()) for name, value in fields.items())


def header(name: str, value: bytes) -> bytes:
    """Return a header as bytes; neither its name nor its value has more than 126 characters."""
    return b"\0" + b"".join(bytes([len(text)]) + text for text in (name.encode(), value))


def _frame(kind: int, flags: int, stream: int, content: bytes = b"") -> bytes:
    length = struct.pack(">I", len(content))[1:]
    return length + bytes([kind, flags]) + struct.pack(">I", stream) + content
