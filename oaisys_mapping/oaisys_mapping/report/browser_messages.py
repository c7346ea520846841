"""Which messages of a browser are handed to viser: those that our pages use.

viser sets any attribute of a field that a message names, takes a file in place of a field's value,
and opens a public tunnel to the page for whoever asks.
"""

from __future__ import annotations

from typing import Any

import msgspec

from oaisys_core.errors import quote

USED = frozenset({"ViewerCameraMessage", "GuiUpdateMessage", "SceneNodeClickMessage"})
"""Kinds of messages: a camera has moved, a field or a button has changed, a camera was clicked."""

MAX_TEXT = 10_000
"""Letters in a field."""


def fault_of(data: bytes | str) -> str:
    """Return why a message is not handed on; nothing: it is.

    Bytes that are no message at all are handed on: viser ends the connection that they come from.
    """
    try:
        message = msgspec.msgpack.decode(data if isinstance(data, bytes) else data.encode())
    except (msgspec.DecodeError, RecursionError, UnicodeError):
        return ""
    if not isinstance(message, dict):
        return ""
    kind = message.get("type")
    if not isinstance(kind, str) or kind not in USED:
        return f"a message of the kind {quote(kind)}, which the page does not use"
    return _update_fault(message.get("updates")) if kind == "GuiUpdateMessage" else ""


def _update_fault(updates: Any) -> str:
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return f"a change of {quote(updates)}, expected one of a field's value"
    value = updates["value"]
    if not isinstance(value, bool | int | float | str):
        return f"the value {quote(value)}, expected a number or a text"
    if isinstance(value, str) and len(value) > MAX_TEXT:
        return f"a text of {len(value)} letters, expected at most {MAX_TEXT}"
    return ""
