"""Which messages of a browser are handed to viser: those that our pages use.

viser sets any attribute of a field that a message names, takes a file in place of a field's value,
and opens a public tunnel to the page for whoever asks. It keeps any camera that a message has, and
its own setters then raise errors about that: a page could no longer send the browser to a place.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from oaisys_core.errors import quote
from oaisys_core.types import FloatArray

USED = frozenset({"ViewerCameraMessage", "GuiUpdateMessage", "SceneNodeClickMessage"})
"""Kinds of messages: a camera has moved, a field or a button has changed, a camera was clicked."""

MAX_TEXT = 10_000
"""Letters in a field."""

MAX_COORDINATE_M = 1e7
"""Of where a browser's camera is, and of the point that it looks at."""

MIN_LOOK_M = 1e-3
"""Between these two; viser lets no camera closer than 0.01 to what it turns around."""


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
    if kind == "ViewerCameraMessage":
        return _camera_fault(message)
    return _update_fault(message.get("updates")) if kind == "GuiUpdateMessage" else ""


def _camera_fault(message: dict[str, Any]) -> str:
    """Return why the pose of a browser's camera is none."""
    position_m, look_at_m = (_numbers(message.get(name), 3) for name in ("position", "look_at"))
    for name, point_m in (("position", position_m), ("look_at", look_at_m)):
        if point_m is None or np.abs(point_m).max() > MAX_COORDINATE_M:
            far = f"3 numbers up to {MAX_COORDINATE_M:g}"
            return f"a camera with {name} {quote(message.get(name))}, expected {far}"
    for name, count in (("up_direction", 3), ("wxyz", 4)):
        values = _numbers(message.get(name), count)
        if values is None or not 0.5 < np.linalg.norm(values) < 2.0:
            unit = f"{count} numbers of about unit length"
            return f"a camera with {name} {quote(message.get(name))}, expected {unit}"
    if np.linalg.norm(np.subtract(look_at_m, position_m)) < MIN_LOOK_M:  # type: ignore[arg-type]
        return f"a camera at the point that it looks at, {quote(message['look_at'])}"
    return ""


def _numbers(values: Any, count: int) -> FloatArray | None:
    """Return (count,) finite numbers; None: the values are none."""
    if not isinstance(values, list) or len(values) != count:
        return None
    if not all(isinstance(value, int | float) for value in values):
        return None
    numbers = np.array(values, np.float64)
    return numbers if np.isfinite(numbers).all() else None


def _update_fault(updates: Any) -> str:
    if not isinstance(updates, dict) or set(updates) != {"value"}:
        return f"a change of {quote(updates)}, expected one of a field's value"
    value = updates["value"]
    if not isinstance(value, bool | int | float | str):
        return f"the value {quote(value)}, expected a number or a text"
    if isinstance(value, str) and len(value) > MAX_TEXT:
        return f"a text of {len(value)} letters, expected at most {MAX_TEXT}"
    return ""
