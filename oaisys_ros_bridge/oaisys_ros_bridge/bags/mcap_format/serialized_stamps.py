"""Reads the stamp, or what else is needed, of a serialised message without deserialising it."""

from __future__ import annotations

import struct
from collections.abc import Callable
from importlib import import_module
from typing import Any

from oaisys_ros_bridge.motion import UNKNOWN_VARIANCE

StampReader = Callable[[bytes], int]
"""Returns the stamp of a message (CDR with its header) in nanoseconds; 0: there is none."""

HEADER = "std_msgs/Header"
COVARIANCE_SIZE = 36
"""Numbers of a covariance; that of the twist ends an odometry message."""
LITTLE_ENDIAN_BIT = 1


def stamp_reader(message_type: type[Any]) -> StampReader | None:
    """Return a function that reads the stamp of a type's messages; None: the type has none.

    The stamp is that of a header in the first field; or, where the first field is a sequence of
    messages that begin with headers, such as ``TFMessage``, that of the first of them.
    """
    first = _first_field(message_type)
    if first == HEADER:
        return lambda data: _stamp_at(data, 4)
    if not first.startswith("sequence<") or "," in first:
        return None
    package, _, name = first.removeprefix("sequence<").removesuffix(">").partition("/")
    if not name or _first_field(getattr(import_module(f"{package}.msg"), name)) != HEADER:
        return None
    return lambda data: _stamp_at(data, 8) if _word_at(data, 4) else 0


def knows_twist(odometry: bytes) -> bool:
    """Return whether an odometry message has a twist, as during a drive; see `odometry_to_msg`."""
    if len(odometry) < 8 * COVARIANCE_SIZE:
        return False
    (variance,) = struct.unpack_from(
        f"{_order(odometry)}d", odometry, len(odometry) - 8 * COVARIANCE_SIZE
    )
    return bool(variance != UNKNOWN_VARIANCE)


def _first_field(message_type: type[Any]) -> str:
    return next(iter(message_type.get_fields_and_field_types().values()), "")


def _order(data: bytes) -> str:
    return "<" if data[1] & LITTLE_ENDIAN_BIT else ">"


def _word_at(data: bytes, offset: int) -> int:
    (word,) = struct.unpack_from(f"{_order(data)}I", data, offset)
    return int(word)


def _stamp_at(data: bytes, offset: int) -> int:
    seconds, nanoseconds = struct.unpack_from(f"{_order(data)}iI", data, offset)
    return int(seconds) * 10**9 + int(nanoseconds)
