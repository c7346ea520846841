"""JSON-able values as protobuf's Struct, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from google.protobuf.struct_pb2 import Struct, Value

from oaisys_core.errors import InvalidInputError


def struct_to_proto(values: Mapping[str, Any], field: str) -> Struct:
    """Return JSON-able values as a message; inverse: `struct_from_proto`."""
    message = Struct()
    try:
        message.update(dict(values))
    except (TypeError, ValueError) as error:
        raise InvalidInputError(field, repr(dict(values)), "values as in JSON") from error
    return message


def struct_from_proto(message: Struct) -> dict[str, Any]:
    """Return a message's values; numbers that are whole become int again."""
    return {key: _value_from_proto(value) for key, value in message.fields.items()}


def whole_as_int(number: float) -> int | float:
    """Return a number as JSON would have it: whole ones as int."""
    return int(number) if number.is_integer() else number


def _value_from_proto(message: Value) -> Any:
    kind = message.WhichOneof("kind")
    if kind == "struct_value":
        return struct_from_proto(message.struct_value)
    if kind == "list_value":
        return [_value_from_proto(value) for value in message.list_value.values]
    if kind == "number_value":
        return whole_as_int(message.number_value)
    return None if kind in (None, "null_value") else getattr(message, kind)
