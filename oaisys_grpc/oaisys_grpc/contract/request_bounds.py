"""How large a request may be: its bytes, its fields, and how deep they lie in each other.

The content is bounded before protobuf parses it: four megabytes of empty structs would become a
million objects.
"""

from __future__ import annotations

import functools
from typing import Any

from oaisys_core.errors import InvalidInputError

MAX_REQUEST_BYTES = 4 * 1024 * 1024
"""Of one request; a larger one is refused unread, with RESOURCE_EXHAUSTED."""

MAX_FIELDS = 2**17
"""Fields of all messages in a request: 2,000 objects with pose, size and label."""

MAX_DEPTH = 64
"""Nested messages; a Struct in a Struct counts three."""

_VARINT, _FIXED64, _LENGTH_DELIMITED, _FIXED32 = 0, 1, 2, 5
_SKIPPED_BYTES = {_FIXED64: 8, _FIXED32: 4}
_LONGEST_KEY = 2**32
_LONGEST_VARINT = 10

Fields = dict[int, Any]
"""Descriptors of the messages that a message's fields hold, by the field's number."""


def check_bounds(data: bytes, descriptor: Any, most_fields: int = MAX_FIELDS) -> None:
    """Refuse a request with too many fields, with too deep ones, or that is no message.

    It stops at the first field too many, so that a refusal takes a fraction of a second.

    Args:
        data: The request's bytes.
        descriptor: Of the message that they should be.
        most_fields: Of all messages together.

    Raises:
        InvalidInputError: The request is out of bounds.
    """
    if _is_flat(descriptor):
        return  # a list of numbers takes no more memory than its bytes
    try:
        _walk(data, descriptor, most_fields)
    except IndexError:
        raise decoding_error(data) from None


def decoding_error(data: bytes) -> InvalidInputError:
    """Return the error of bytes that are no message."""
    return InvalidInputError("request", f"{len(data)} bytes", "a message of this call")


def _walk(data: bytes, descriptor: Any, most_fields: int) -> None:
    at, count = 0, 0
    open_messages = [(len(data), _messages_in(descriptor))]
    while open_messages:
        end, messages = open_messages[-1]
        if at >= end:
            if at > end:
                raise decoding_error(data)
            open_messages.pop()
            continue
        count += 1
        if count > most_fields:
            raise _refusal(f"more than {most_fields} fields", f"at most {most_fields}")
        key, at = _varint(data, at)
        inner = messages.get(key >> 3) if key & 7 == _LENGTH_DELIMITED else None
        if inner is None:
            at = _behind(data, at, key)
            continue
        length, at = _varint(data, at)
        if at + length > end:
            raise decoding_error(data)
        if len(open_messages) == MAX_DEPTH:
            raise _refusal(f"messages more than {MAX_DEPTH} deep", f"at most {MAX_DEPTH}")
        open_messages.append((at + length, _messages_in(inner)))


def _behind(data: bytes, at: int, key: int) -> int:
    """Return the end of a field that is no message; its value begins at ``at``."""
    kind = key & 7
    if not 8 <= key < _LONGEST_KEY:  # no field at all
        raise decoding_error(data)
    if kind == _LENGTH_DELIMITED:
        length, at = _varint(data, at)
        return at + length
    if kind == _VARINT:
        return _varint(data, at)[1]
    if kind not in _SKIPPED_BYTES:  # a group, which no call of ours has
        raise decoding_error(data)
    return at + _SKIPPED_BYTES[kind]


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the number that begins there, and where it ends."""
    byte = data[at]
    if byte < 0x80:
        return byte, at + 1
    number = byte & 0x7F
    for index in range(1, _LONGEST_VARINT):
        byte = data[at + index]
        number |= (byte & 0x7F) << 7 * index
        if byte < 0x80:
            return number, at + index + 1
    raise decoding_error(data)


@functools.cache
def _messages_in(descriptor: Any) -> Fields:
    return {
        field.number: field.message_type
        for field in descriptor.fields
        if field.message_type is not None
    }


@functools.cache
def _is_flat(descriptor: Any) -> bool:
    """Return whether a message holds fields, but neither messages nor lists of texts."""
    # Parsing a message without fields lets some bytes pass that are none.
    return bool(descriptor.fields) and not any(
        field.message_type is not None
        or (field.is_repeated and field.cpp_type == field.CPPTYPE_STRING)
        for field in descriptor.fields
    )


def _refusal(received: str, expected: str) -> InvalidInputError:
    return InvalidInputError("request", received, expected)
