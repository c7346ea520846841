"""Conversion of dataclasses to messages and back, field by field."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from google.protobuf.message import Message

RecordT = TypeVar("RecordT")
MessageT = TypeVar("MessageT", bound=Message)


class TwoWay(Protocol):
    """Two functions that undo each other."""

    @property
    def to_proto(self) -> Callable[[Any], Any]:
        """Returns what a message holds."""

    @property
    def from_proto(self) -> Callable[[Any], Any]:
        """Returns the value of a field."""


class Conversion(NamedTuple):
    """The conversion of a value to what a message holds, and back."""

    to_proto: Callable[[Any], Any]
    from_proto: Callable[[Any], Any]


def each(one: TwoWay) -> Conversion:
    """Return the conversion of several values."""
    return Conversion(
        lambda values: list(map(one.to_proto, values)),
        lambda messages: tuple(map(one.from_proto, messages)),
    )


class RecordConversion(Generic[RecordT, MessageT]):
    """The conversion of a dataclass.

    A field of the record is the field of that name, in lower case, of the message. Texts and
    numbers stay as they are; of a repeated field the record has a tuple, of a map a dict, and None
    where an optional field is absent. Whatever else is needed must be given.
    """

    def __init__(
        self,
        record: type[RecordT],
        message: type[MessageT],
        renamed: Mapping[str, str] | None = None,
        without: str = "",
        **given: TwoWay,
    ) -> None:
        """Prepare the conversion.

        Args:
            record: The dataclass.
            message: The message.
            renamed: Fields of the message that have another name, by the record's name.
            without: A field of the record that the message does not hold.
            given: Conversions of fields, by the record's name.

        Raises:
            KeyError: The message has no field for one of the record, or the record none for one of
                the conversions.
            TypeError: A field is a message, and its conversion is not given.
        """
        self._record, self._message = record, message
        self._fields: list[tuple[str, str, TwoWay, bool]] = []
        described = message.DESCRIPTOR.fields_by_name
        for name in (field.name for field in fields(record)):  # type: ignore[arg-type]
            if name == without:
                continue
            key = (renamed or {}).get(name, name.lower())
            conversion = given.pop(name, None) or _usual(described[key])
            is_optional = described[key].containing_oneof is not None
            self._fields.append((name, key, conversion, is_optional))
        if given:
            raise KeyError(f"{record.__name__} has no field {', '.join(given)}")

    def to_proto(self, record: RecordT, **others: Any) -> MessageT:
        """Return the message; ``others`` are the values of fields that the record has not."""
        for name, key, conversion, _ in self._fields:
            value = getattr(record, name)
            others[key] = None if value is None else conversion.to_proto(value)
        return self._message(**others)

    def from_proto(self, message: MessageT) -> RecordT:
        """Return the record of a message; inverse: `to_proto`."""
        values = {
            name: None
            if is_optional and not message.HasField(key)
            else conversion.from_proto(getattr(message, key))
            for name, key, conversion, is_optional in self._fields
        }
        return self._record(**values)


def _unchanged(value: Any) -> Any:
    return value


def _usual(field: Any) -> Conversion:
    kind = field.message_type
    if kind is not None and kind.GetOptions().map_entry:
        return Conversion(dict, dict)
    if kind is not None:
        raise TypeError(f"{field.full_name} is a {kind.name}: its conversion must be given")
    return Conversion(_unchanged, tuple if field.is_repeated else _unchanged)
