"""A browser of a live page that says what no browser would: viser's messages, byte for byte."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import msgspec
import viser
import zstandard
from websockets.sync.client import connect

CAMERA = {
    "wxyz": (0.5, -0.5, 0.5, -0.5),
    "position": (0.0, 0.0, 3.0),
    "fov": 1.0,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 48,
    "image_width": 64,
    "look_at": (0.1, 0.0, 3.0),
    "up_direction": (0.0, 0.0, 1.0),
}
"""What a browser says of its camera, first of all."""


def masked_frame(message: dict[str, Any]) -> bytes:
    """Return a message of at most 65,535 bytes as the binary frame of a WebSocket's client."""
    data = msgspec.msgpack.encode(message)
    return b"\x82\xfe" + len(data).to_bytes(2, "big") + bytes(4) + data


class RawBrowser:
    """One connection to a page; use it in a ``with`` block.

    Attributes:
        labels: Fields and buttons that it was sent, with their ids.
        texts: Lines of the page that it was sent.
    """

    def __init__(self, url: str) -> None:
        address = urlsplit(url)
        origin: Any = f"http://{address.netloc}"
        self._socket = connect(
            f"ws://{address.netloc}{address.path}",
            origin=origin,
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item] # a NewType
            max_size=None,
        )
        self.labels: dict[str, str] = {}
        self.texts: list[str] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._socket.close()

    def send_bytes(self, data: bytes | str) -> None:
        self._socket.send(data)

    def send(self, kind: str, **fields: Any) -> None:
        self.send_bytes(msgspec.msgpack.encode({"type": kind, **fields}))

    def look(self, **changes: Any) -> None:
        """Say where the camera is."""
        self.send("ViewerCameraMessage", **(CAMERA | changes))

    def set_value(self, label: str, value: Any, timeout_s: float) -> None:
        """Change a field, or press a button, by its label."""
        self.read_until(lambda: label in self.labels, timeout_s)
        self.send("GuiUpdateMessage", uuid=self.labels[label], updates={"value": value})

    def read_until(self, condition: Any, timeout_s: float) -> None:
        """Read what the page sends until a condition holds; raises TimeoutError."""
        while not condition():
            data = self._socket.recv(timeout_s)
            assert isinstance(data, bytes)
            size = int.from_bytes(data[8:16], "little")
            packed = zstandard.ZstdDecompressor().decompress(data[16 : 16 + size])
            for message in msgspec.msgpack.decode(packed)["messages"]:
                self._take(message)

    def shows(self, text: str, timeout_s: float) -> None:
        """Wait until a text, a note or a line of the page has some words."""
        self.read_until(lambda: any(text in each for each in self.texts), timeout_s)

    def _take(self, message: dict[str, Any]) -> None:
        props = message.get("props") or message.get("updates") or {}
        if "uuid" in message and props.get("label"):
            self.labels[props["label"]] = message["uuid"]
        for name in ("content", "_markdown", "body", "title"):
            if isinstance(props.get(name), str):
                self.texts.append(props[name])
