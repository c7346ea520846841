"""Conversion of pydantic's errors to our form: path, value received, what was expected."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from oaisys_core.config.section import Section
from oaisys_core.errors import InvalidInputError, did_you_mean, one_of_keys

MOST_FAULTS = 100
"""Errors that are told; a hostile file has hundreds of thousands."""

UNKNOWN_KEY = "extra_forbidden"
MISSING_KEY = "missing"

_TRUTH, _WHOLE, _NUMBER, _TEXT = "true or false", "a whole number", "a number", "text"
_MAPPING, _LIST = "a mapping of keys to values", "a list"
_DATE, _TIME = "a date as YYYY-MM-DD", "a date and time as YYYY-MM-DDThh:mm:ss"

WORDS: Mapping[str, str] = {
    UNKNOWN_KEY: "a key that is known",
    MISSING_KEY: "a value: the key is missing",
    "invalid_key": "text as the key",
    "none_required": "nothing",
    "bool_type": _TRUTH,
    "bool_parsing": _TRUTH,
    "int_type": _WHOLE,
    "int_parsing": _WHOLE,
    "int_parsing_size": _WHOLE,
    "int_from_float": _WHOLE,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "finite_number": "a finite number",
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number of at least {ge}",
    "less_than": "a number below {lt}",
    "less_than_equal": "a number of at most {le}",
    "multiple_of": "a multiple of {multiple_of}",
    "string_type": _TEXT,
    "string_unicode": _TEXT,
    "string_too_short": "text of at least {min_length} characters",
    "string_too_long": "text of at most {max_length} characters",
    "string_pattern_mismatch": "text that matches {pattern}",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "union_tag_invalid": "{expected_tags}",
    "union_tag_not_found": "a value: the key is missing",
    "dict_type": _MAPPING,
    "mapping_type": _MAPPING,
    "model_type": _MAPPING,
    "model_attributes_type": _MAPPING,
    "dataclass_type": _MAPPING,
    "list_type": _LIST,
    "tuple_type": _LIST,
    "set_type": _LIST,
    "frozen_set_type": _LIST,
    "iterable_type": _LIST,
    "too_short": "at least {min_length} of them",
    "too_long": "at most {max_length} of them",
    "path_type": "a path",
    "date_type": _DATE,
    "date_parsing": _DATE,
    "date_from_datetime_parsing": _DATE,
    "date_from_datetime_inexact": _DATE,
    "datetime_type": _TIME,
    "datetime_parsing": _TIME,
    "datetime_object_invalid": _TIME,
    "datetime_from_date_parsing": _TIME,
    "timezone_aware": "a time with its zone, such as 2026-06-01T12:00:00+00:00",
    "timezone_naive": "a time without a zone",
    "is_instance_of": "a {class}",
}
"""What was expected, by pydantic's type of error; limits are filled in."""


@dataclass(frozen=True)
class ConfigFault:
    """An invalid value.

    Attributes:
        location: Keys and indices that lead to it.
        received: The value; None if it is missing.
        expected: What would have been accepted, as text after "expected".
        kind: pydantic's type of error.
        statement: A description of what is wrong, if the check gives one instead.
    """

    location: tuple[int | str, ...]
    received: object
    expected: str
    kind: str
    statement: str | None = None

    @property
    def path(self) -> str:
        """The location with dots between its parts."""
        return ".".join(map(str, self.location))

    @property
    def hint(self) -> str:
        """Which of the expected values was probably meant, as text after them, or nothing."""
        return did_you_mean(self.received, re.findall(r"'([^']+)'", self.expected))


def faults_of(error: ValidationError, data: object, kind: Any) -> list[ConfigFault]:
    """Return the first `MOST_FAULTS` errors, without those that only repeat one of a nested value.

    Args:
        error: What pydantic found.
        data: The data that it checked.
        kind: The section, or type, that the data should have been.
    """
    return [
        _join([_fault(detail, data, kind) for detail in details])
        for details in islice(_by_location(error, data).values(), MOST_FAULTS)
    ]


def fault_count(error: ValidationError, data: object) -> int:
    """Return how many errors `faults_of` would return without a bound."""
    return len(_by_location(error, data))


def _by_location(
    error: ValidationError, data: object
) -> dict[tuple[int | str, ...], list[ErrorDetails]]:
    """Return what pydantic found at each location, without what holds another error."""
    details = error.errors(include_url=False)
    around = {detail["loc"][:end] for detail in details for end in range(len(detail["loc"]))}
    found: dict[tuple[int | str, ...], list[ErrorDetails]] = {}
    for detail in details:
        if detail["loc"] not in around:
            found.setdefault(_location(detail, data), []).append(detail)
    # Of a union, whose alternatives are in pydantic's locations, the one that went deepest counts.
    outer = {location[:end] for location in found for end in range(len(location))}
    return {location: details for location, details in found.items() if location not in outer}


def _join(faults: Sequence[ConfigFault]) -> ConfigFault:
    """Return one error for all at a location: each alternative of a union raises its own."""
    first = faults[0]
    for fault in faults[1:]:
        if fault.expected not in first.expected:
            first = replace(first, expected=f"{first.expected} or {fault.expected}")
    return first


def refusal(error: ValidationError, data: object, kind: Any, *path: str) -> InvalidInputError:
    """Return the first error as an `InvalidInputError`.

    Args:
        error: What pydantic found.
        data: The data that it checked.
        kind: The section, or type, that the data should have been.
        path: Path of the checked data, before the path of the error.
    """
    fault = faults_of(error, data, kind)[0]
    where = ".".join((*path, *map(str, fault.location)))
    return InvalidInputError(where, fault.received, fault.expected + fault.hint)


def _keys_of_section(kind: Any, data: Any, path: Iterable[int | str]) -> set[str]:
    """Return the keys of the section at a path below a type, or of all that it may be."""
    return {key for section in _sections_at(kind, data, path) for key in section.model_fields}


def _kinds_of_section(kind: Any, data: Any, path: Iterable[int | str]) -> list[str]:
    """Return the kinds of the sections that there may be at a path below a type."""
    tags = [each.model_fields["kind"] for each in _sections_at(kind, data, path) if _has_kind(each)]
    return [str(value) for tag in tags for value in get_args(tag.annotation)]


def _default_kind(kind: Any, data: Any, path: Sequence[int | str]) -> str:
    """Return which kind a section has by default, as text behind its keys, if it says none."""
    kinds = _kinds_of_section(kind, data, path)
    for part in path:
        data = data[part]
    is_default = len(kinds) == 1 and "kind" not in data
    return f" of kind {kinds[0]!r}, the default" if is_default else ""


def _sections_at(kind: Any, data: Any, path: Iterable[int | str]) -> list[type[Section]]:
    kinds = alternatives(kind, data)
    for part in path:
        data = data[part]
        inner = [each for kind in kinds for each in inner_types(kind, part)]
        kinds = [each for kind in inner for each in alternatives(kind, data)]
    return [kind for kind in kinds if _is_section(kind)]


def _is_section(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Section)


def alternatives(kind: Any, data: Any) -> list[Any]:
    """Return the types that a union joins, without sections for data of another ``kind``."""
    if get_origin(kind) is Annotated:
        return alternatives(get_args(kind)[0], data)
    if get_origin(kind) in (Union, UnionType):
        found = [each for part in get_args(kind) for each in alternatives(part, data)]
        return found if not isinstance(data, Mapping) or "kind" in data else _by_default(found)
    if _has_kind(kind) and isinstance(data, Mapping) and "kind" in data:
        return [kind] if data["kind"] in get_args(kind.model_fields["kind"].annotation) else []
    return [kind]


def _by_default(kinds: list[Any]) -> list[Any]:
    """Return the types that data without a ``kind`` may be, see `ByKind`."""
    tags = {kind: kind.model_fields["kind"] for kind in kinds if _has_kind(kind)}
    if all(tag.is_required() for tag in tags.values()):
        return kinds
    return [kind for kind in kinds if kind not in tags or not tags[kind].is_required()]


def _has_kind(kind: Any) -> bool:
    tag = kind.model_fields.get("kind") if _is_section(kind) else None
    return tag is not None and get_origin(tag.annotation) is Literal


def inner_types(kind: Any, part: int | str) -> list[Any]:
    """Return the types that an entry of a section, a mapping or a list may have."""
    if not _is_section(kind):
        return list(get_args(kind))
    field = kind.model_fields.get(part)
    return [] if field is None else [field.annotation]


def _location(detail: ErrorDetails, data: object) -> tuple[int | str, ...]:
    """Return an error's location without the names of types that pydantic inserts."""
    loc, here = detail["loc"], data
    location: list[int | str] = []
    is_missing = detail["type"] == MISSING_KEY
    for index, part in enumerate(loc):
        is_key = isinstance(here, Mapping) and part in here
        is_index = isinstance(here, list | tuple) and isinstance(part, int) and part < len(here)
        if is_key or is_index:
            here = here[part]  # type: ignore[index]
        elif index < len(loc) - 1 or not is_missing or not isinstance(here, Mapping | list):
            continue
        location.append(part)
    if detail["type"].startswith("union_tag_"):
        # The error is in the tag, not in the mapping around it.
        location.append(_tag(detail))
    return tuple(location)


def _tag(detail: ErrorDetails) -> str:
    """Return the key whose value selects the section."""
    return str(detail["ctx"]["discriminator"]).strip("'")


def _fault(detail: ErrorDetails, data: object, data_kind: Any) -> ConfigFault:
    kind, received = detail["type"], detail["input"]
    location = _location(detail, data)
    if kind.startswith("union_tag_"):
        received = received.get(_tag(detail)) if isinstance(received, Mapping) else received
    is_kind_missing = kind == "union_tag_not_found"
    if is_kind_missing:
        kind = MISSING_KEY
    if kind == MISSING_KEY:
        received = None
    expected, statement = _expectation(detail)
    if kind == UNKNOWN_KEY:
        *place, key = location
        expected = one_of_keys(_keys_of_section(data_kind, data, place), key)
        expected += _default_kind(data_kind, data, place)
    if is_kind_missing:
        expected = ", ".join(map(repr, _kinds_of_section(data_kind, data, location[:-1])))
    return ConfigFault(location, received, expected, kind, statement)


def _expectation(detail: ErrorDetails) -> tuple[str, str | None]:
    """Return what was expected, and the statement of a check that is worded differently."""
    kind, context = detail["type"], detail.get("ctx", {})
    words = WORDS.get(kind)
    if words is not None:
        return words.format_map({key: _show(value) for key, value in context.items()}), None
    is_own = kind in ("value_error", "assertion_error")
    text = str(context["error"]) if is_own else detail["msg"]
    if text.startswith("expected "):
        return text.removeprefix("expected "), None
    return f"another value: {text}", text


def _show(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)
