"""A table of a node's parameters, one row each.

Declarations, descriptors, checks and the reference page are made from the rows. No ROS in here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from oaisys_core.errors import InvalidInputError, did_you_mean

Settings = Callable[[], Mapping[str, Any]]
"""Returns the values of a node's parameters by name, all of one moment."""

ParameterValue = bool | int | float | str | list[str]
Rule = Callable[[Mapping[str, Any]], None]
"""Raises `InvalidInputError` if values that are valid each do not fit together."""

_TYPE_NAMES: Mapping[type, str] = {
    bool: "bool",
    int: "integer",
    float: "double",
    str: "string",
    list: "string_array",
}


class Changeable(Enum):
    """When a parameter can be set."""

    ANY_TIME = "at any time"
    UNCONFIGURED = "while the node is unconfigured"
    AT_START = "at start only"


@dataclass(frozen=True)
class ParameterRow:
    """One parameter.

    Attributes:
        name: As ROS knows it.
        default: Its type is the parameter's: bool, int, float, str or a list of str.
        description: One sentence without its unit and range.
        unit: Such as ``s`` or ``m``; empty: it has none.
        least, most: Of a number; None: no bound. They are part of the range.
        choices: Of a string: all valid values; empty: any.
        pattern: Of a string: regular expression that the whole value must match.
        expects: What the pattern means, in words.
        changeable: When it can be set.
    """

    name: str
    default: ParameterValue
    description: str
    unit: str = ""
    least: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()
    pattern: str = ""
    expects: str = ""
    changeable: Changeable = Changeable.ANY_TIME

    @property
    def kind(self) -> type:
        """Python's type of its values."""
        return type(self.default)

    @property
    def type_name(self) -> str:
        """ROS's name of its type."""
        return _TYPE_NAMES[self.kind]

    @property
    def expectation(self) -> str:
        """Its valid values in words: type, range, choices."""
        unit = f" {self.unit}" if self.unit else ""
        if self.choices:
            return "one of " + ", ".join(repr(choice) for choice in self.choices)
        if self.expects:
            return f"{self.type_name}: {self.expects}"
        if self.least is not None and self.most is not None:
            return f"{self.type_name} from {self.least:g} to {self.most:g}{unit}"
        if self.least is not None:
            return f"{self.type_name} of at least {self.least:g}{unit}"
        if self.most is not None:
            return f"{self.type_name} of at most {self.most:g}{unit}"
        return self.type_name + (f" in{unit}" if unit else "")

    def check(self, value: object) -> Any:
        """Return a value as the parameter's type; a double may be given as a whole number.

        Raises:
            InvalidInputError: Wrong type, out of range, or none of the choices.
        """
        if self.kind is float and type(value) is int:
            value = float(value)
        if type(value) is not self.kind or not self._allows(value):
            hint = did_you_mean(value, self.choices)
            raise InvalidInputError(self.name, value, self.expectation + hint)
        return value

    def _allows(self, value: Any) -> bool:
        if isinstance(value, float | int):
            least = -math.inf if self.least is None else self.least
            most = math.inf if self.most is None else self.most
            return math.isfinite(value) and least <= value <= most
        if isinstance(value, str):
            fits = not self.pattern or re.fullmatch(self.pattern, value) is not None
            return fits and (not self.choices or value in self.choices)
        return all(isinstance(part, str) for part in value)


class ParameterTable:
    """All parameters of one node, by name, in the order of the rows.

    Args:
        rows: One for each parameter.
        rules: Conditions on several of them.
    """

    def __init__(self, rows: Sequence[ParameterRow], rules: Sequence[Rule] = ()) -> None:
        self._rows = {row.name: row for row in rows}
        self._rules = tuple(rules)

    def __iter__(self) -> Iterator[ParameterRow]:
        return iter(self._rows.values())

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def __getitem__(self, name: str) -> ParameterRow:
        """Return a row; `KeyError` where there is none."""
        return self._rows[name]

    def check_together(self, values: Mapping[str, Any]) -> None:
        """Raise `InvalidInputError` if the values do not fit together."""
        for rule in self._rules:
            rule(values)
