"""The check of everything that a configuration's draws and variants may become."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from pydantic import ValidationError
from pydantic_core import InitErrorDetails

from oaisys_core.config.draws import (
    CHOOSE,
    RANGE,
    Draw,
    Draws,
    Location,
    RangeDraw,
    is_draw,
    locate,
    location_of,
    put,
    value_at,
)
from oaisys_core.config.expectations import faults_of
from oaisys_core.errors import InvalidInputError, quote


class CheckedConfig(Protocol):
    """What is asked of a configuration that was checked."""

    @property
    def label_names(self) -> Mapping[int, str]:
        """Labels by id."""

    def model_dump(self) -> dict[str, Any]:
        """Return it as plain data."""


Check = Callable[[dict[str, Any]], CheckedConfig]
"""Checks the data of a configuration."""


def check_options(plain: dict[str, Any], draws: Draws, data: Any, kind: Any, check: Check) -> Draws:
    """Return the draws with their options as they are after the check, with all defaults.

    Args:
        plain: The configuration, with one possible value instead of each draw.
        draws: The draws by location.
        data: The configuration as it was given.
        kind: Class of the configuration.
        check: Checks the data of one.

    Raises:
        ValidationError: An option is invalid, each error at the option.
    """
    labels: dict[int, str] = {}
    checked: Draws = {}
    for location, draw in draws.items():
        values: list[Any] = []
        where = location
        for index in range(len(draw.options)):
            where, value = _check_option(plain, (location, draw, index), data, kind, check, labels)
            values.append(value)
        checked[where] = draw.with_options(values)
    return checked


def _check_option(
    plain: dict[str, Any],
    which: tuple[Location, Draw, int],
    data: Any,
    kind: Any,
    check: Check,
    labels: dict[int, str],
) -> tuple[Location, Any]:
    """Return where an option stands in checked data, and what it is there."""
    location, draw, index = which
    place = _place_of_option(data, *which)
    with_option = copy.deepcopy(plain)
    option = draw.options[index]
    put(with_option, location, option)
    try:
        checked = check(with_option)
    except ValidationError as error:
        raise _errors_at(error, with_option, kind, location, place) from error
    try:
        dumped = checked.model_dump()
        where = locate(dumped, location)
        found = where, value_at(dumped, where)
    except (KeyError, IndexError, TypeError):
        raise error_at(place, option, "a value: this key cannot be drawn") from None
    check_labels(labels, checked.label_names, place, option)
    return found


def check_labels(
    known: dict[int, str], names: Mapping[int, str], place: Location, received: object
) -> None:
    """Add labels to those that are known; all worlds of a configuration share their ids.

    Raises:
        ValidationError: An id has two names.
    """
    for semantic_id, label in names.items():
        other = known.setdefault(semantic_id, label)
        if other != label:
            text = f"one name for semantic_id {semantic_id}, not {quote(other)} and {quote(label)}"
            raise error_at(place, received, text)


def error_at(place: Location, received: object, expected: str) -> ValidationError:
    """Return the error that a value at a place is not what was expected."""
    return ValidationError.from_exception_data("configuration", [_line(place, received, expected)])


def error_of(error: InvalidInputError) -> ValidationError:
    """Return an `InvalidInputError` whose field is a location as pydantic's error."""
    return error_at(location_of(error.field), error.received, error.expected)


def errors_below(
    error: ValidationError, data: object, kind: Any, place: Location
) -> ValidationError:
    """Return errors of data that stand at a place of other data."""
    return _errors_at(error, data, kind, (), place)


def _errors_at(
    error: ValidationError, data: object, kind: Any, location: Location, place: Location
) -> ValidationError:
    """Return errors of data, of which a part stands at another place; others are told there."""
    lines = []
    for fault in faults_of(error, data, kind):
        at, size = fault.location, len(location)
        expected = fault.statement or f"{fault.expected}{fault.hint}"
        if at[:size] == location:
            lines.append(_line((*place, *at[size:]), fault.received, expected))
        else:
            received = value_at(data, location)
            text = f"another value, because of {fault.path or 'the whole'}: {expected}"
            lines.append(_line(place, received, text))
    return ValidationError.from_exception_data("configuration", lines)


def _line(place: Location, received: object, expected: str) -> InitErrorDetails:
    error = ValueError(f"expected {expected.removeprefix('expected ')}")
    return InitErrorDetails(type="value_error", loc=place, input=received, ctx={"error": error})


def _place_of_option(data: Any, location: Location, draw: Draw, index: int) -> Location:
    """Return where an option stands in the data as it was given."""
    if not is_draw(value_at(data, location)):
        return (*location, index)
    return (*location, RANGE if isinstance(draw, RangeDraw) else CHOOSE, index)
