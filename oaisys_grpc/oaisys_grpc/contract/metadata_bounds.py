"""How large metadata may be: checked before they are sent, so that the server takes the request."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_grpc.contract.request_bounds import (
    MAX_DEPTH,
    MAX_FIELDS,
    MAX_REQUEST_BYTES,
    check_bounds,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

MAX_METADATA_BYTES = MAX_REQUEST_BYTES - 256 * 1024
"""Of all metadata of a request as a message: pose, ids and names of sensors have room beside it."""

MAX_METADATA_FIELDS = MAX_FIELDS - 4096
"""Of all metadata of a request; a number in an object counts as four, in a list as two."""

MAX_NESTING = (MAX_DEPTH - 3) // 3
"""Objects and lists inside of each other: each becomes up to three messages, below the request's,
the metadata's and the sensors' own."""

_FIELDS_OF_KEY, _FIELDS_OF_ITEM = 4, 2

_Path = tuple[Any, Any]
"""The path of a container's parent, and the container's key; a root has its own name there."""


def check_values(values: Mapping[str, Any], field: str) -> None:
    """Refuse values that would become a Struct with too many or too deep messages.

    Raises:
        InvalidInputError: They are nested more than `MAX_NESTING` times, or have more than
            `MAX_METADATA_FIELDS`.
    """
    count = 0
    waiting: list[tuple[_Path, int, Any]] = [((None, field), 1, values)]
    while waiting:
        path, depth, container = waiting.pop()
        if depth > MAX_NESTING:
            received = f"more than {MAX_NESTING} objects and lists inside of each other"
            expected = f"at most {MAX_NESTING}, the module's own object included"
            raise InvalidInputError(_path_text(path), received, expected)
        is_object = isinstance(container, Mapping)
        count += len(container) * (_FIELDS_OF_KEY if is_object else _FIELDS_OF_ITEM)
        if count > MAX_METADATA_FIELDS:
            received = f"values that become {count} fields of messages, or more"
            raise _too_many_fields(field, received)
        items: Iterable[tuple[Any, Any]]
        items = container.items() if is_object else enumerate(container)
        waiting += [
            ((path, key), depth + 1, value)
            for key, value in items
            if isinstance(value, dict | list | tuple)
        ]


def check_size(message: pb.ModuleMetadata) -> None:
    """Refuse metadata that leave too little room in a request.

    Raises:
        InvalidInputError: They are too large together; the error names the largest part.
    """
    size = message.ByteSize()
    if size > MAX_METADATA_BYTES:
        expected = f"at most {MAX_METADATA_BYTES} bytes for all modules together"
        raise InvalidInputError(_largest_part(message), f"{size} bytes as a message", expected)
    if size <= 2 * MAX_METADATA_FIELDS:
        return  # a field takes two bytes or more
    try:
        check_bounds(message.SerializeToString(), message.DESCRIPTOR, MAX_METADATA_FIELDS)
    except InvalidInputError as error:
        raise _too_many_fields(_largest_part(message), error.received) from None


def _too_many_fields(field: str, received: object) -> InvalidInputError:
    expected = (
        f"at most {MAX_METADATA_FIELDS} for all modules together, "
        "where a value in an object counts as four, in a list as two"
    )
    return InvalidInputError(field, received, expected)


def _largest_part(message: pb.ModuleMetadata) -> str:
    sizes: dict[str, int] = {}
    for field, part in message.ListFields():
        name = field.name.removeprefix("typed_")
        sizes[name] = sizes.get(name, 0) + part.ByteSize()
    return f"metadata.{max(sizes, key=lambda name: sizes[name])}"


def _path_text(path: _Path) -> str:
    def keys(at: _Path | None) -> Iterator[str]:
        while at is not None:
            at, key = at
            yield str(key)

    return ".".join(reversed(list(keys(path))))
