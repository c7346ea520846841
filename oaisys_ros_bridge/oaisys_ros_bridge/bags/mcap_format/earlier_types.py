"""Messages of types that had fewer fields when they were recorded."""

from __future__ import annotations

from typing import Any

from mcap.records import Schema
from rosidl_parser.definition import AbstractNestedType, NamespacedType

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.bags.mcap_format.message_decoding import DECODE_ERRORS, decoder_of
from oaisys_ros_bridge.bags.mcap_format.message_definition import message_class, message_definition


def decode_earlier(data: bytes, schema: Schema, kind: type[Any]) -> Any:
    """Return a message by a bag's description of its type, with the fields that ``kind`` has now.

    Fields that the description lacks keep their defaults. None: the type was described as it is
    now, so that the bytes are damaged, or they are not as described, or that cannot be read.

    Args:
        data: In CDR, with its header.
        schema: The description.
        kind: The class of the message.
    """
    if schema.data.decode("utf-8", "replace") == message_definition(schema.name):
        return None
    try:
        decode = decoder_of("cdr", schema, schema.name)
        return None if decode is None else _convert(decode(data), kind)
    except (AssertionError, InvalidInputError, *DECODE_ERRORS):
        return None


def _convert(decoded: Any, kind: type[Any]) -> Any:
    """Return a message with the values of those of its fields that were decoded."""
    message = kind()
    for name, slot in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        if not hasattr(decoded, name):
            continue
        value = getattr(decoded, name)
        is_list = isinstance(slot, AbstractNestedType)
        inner = slot.value_type if is_list else slot
        if isinstance(inner, NamespacedType):
            of = message_class("/".join(inner.namespaced_name()))
            value = [_convert(each, of) for each in value] if is_list else _convert(value, of)
        setattr(message, name, value)
    return message
