"""Decodes messages by the definitions of their types in a bag, without ROS.

Definitions are from outside: what the decoder needs of them is taken out within bounds, because its
parser takes time with the square of the number of fields, and exponential time for some names.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from oaisys_core.errors import InvalidInputError

DECODE_ERRORS = (
    *(McapError, struct.error, ValueError, AttributeError, TypeError, KeyError, IndexError),
    *(NotImplementedError, RecursionError, OverflowError, MemoryError),
)
"""What the decoder raises for a damaged message, or for a type that is described otherwise."""

MAX_DEFINITION_BYTES = 1_000_000
"""Of a type with those of all nested types, comments included."""

MAX_FIELDS = 2_000
"""Of a type and all nested ones."""

_MAX_DECODERS = 256

_SEPARATOR = re.compile(r"={3,}")
_TYPE_LINE = re.compile(r"MSG:\s+([A-Za-z][\w/]{0,200})", re.ASCII)
_FIELD = re.compile(
    r"([A-Za-z][\w/]{0,200}(?:<=\d{1,9})?(?:\[(?:(?:<=)?[1-9]\d{0,8})?\])?)\s+([a-z]\w{0,200})(?:\s.*)?",
    re.ASCII,
)
"""Type and name, before a default."""

_CONSTANT = re.compile(r"[A-Za-z]\w*(?:<=\d{1,9})?\s+[A-Z]\w*\s*=.*", re.ASCII)


class _MessageBytes(bytes):
    """Bytes of a message, of which the decoder takes no array that is longer than they are.

    Else an element could have no byte, and there may be 2^32 of them.
    """

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, slice) and key.stop is not None and key.stop > len(self):
            raise ValueError(f"it ends after {len(self)} bytes, {key.stop} are needed")
        return super().__getitem__(key)


def decoder_of(
    message_encoding: str, schema: Schema | None, where: str
) -> Callable[[bytes], Any] | None:
    """Return what decodes messages of a type; None: they are not in CDR, or it is not in ros2msg.

    Args:
        message_encoding: Of the messages.
        schema: The bag's description of the type.
        where: What errors call it.

    Raises:
        InvalidInputError: The definition is too large, or cannot be understood.
    """
    if schema is None or (message_encoding, schema.encoding) != ("cdr", "ros2msg"):
        return None
    if len(schema.data) > MAX_DEFINITION_BYTES:
        expected = f"a definition of at most {MAX_DEFINITION_BYTES} bytes"
        raise InvalidInputError(where, f"{len(schema.data)} bytes", expected)
    return _decoder(schema.name, schema.data, where)


@lru_cache(_MAX_DECODERS)
def _decoder(name: str, data: bytes, where: str) -> Callable[[bytes], Any]:
    lines = list(_needed_lines(data.decode("utf-8", "replace"), where))
    plain = Schema(id=0, name=name, encoding="ros2msg", data="\n".join(lines).encode())
    try:
        found: Callable[[bytes], Any] | None = DecoderFactory().decoder_for("cdr", plain)
    except Exception as error:  # the parser raises some that it does not export
        raise InvalidInputError(where, name, f"a type that can be decoded ({error})") from error
    if found is None:
        raise InvalidInputError(where, name, "a type that can be decoded")
    decode = found
    return lambda data: decode(_MessageBytes(data))


def _needed_lines(definition: str, where: str) -> Iterator[str]:
    """Yield the lines of nested types and of fields, without constants, defaults and comments.

    Raises:
        InvalidInputError: A line is none of these, or there are too many fields.
    """
    fields = 0
    for written in definition.splitlines():
        line = written.partition("#")[0].strip()
        if not line or _CONSTANT.fullmatch(line):
            continue
        if _SEPARATOR.fullmatch(line) or _TYPE_LINE.fullmatch(line):
            yield line
            continue
        field = _FIELD.fullmatch(line)
        if field is None:
            raise InvalidInputError(where, line, "a field of a message, such as float64 x")
        fields += 1
        if fields > MAX_FIELDS:
            raise InvalidInputError(where, "more fields", f"at most {MAX_FIELDS} fields")
        yield f"{field[1]} {field[2]}"
