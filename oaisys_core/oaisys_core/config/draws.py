"""Values of a configuration that each world draws: ranges of numbers, and choices of anything.

``{range: [least, most]}`` and ``{choose: [a, b], weights: [3, 1]}`` may stand for any value of a
world. Where a key takes no list, ``[least, most]`` is short for a range of numbers and a list with
a name in it for a choice.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from sys import float_info
from types import NoneType
from typing import Any, get_origin

import numpy as np

from oaisys_core.config.expectations import alternatives, inner_types
from oaisys_core.config.section import LEAST_WEIGHT, MOST_WEIGHT
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.numbers import whole_of

Location = tuple[int | str, ...]
"""Keys and indices that lead to a value."""

RANGE, CHOOSE, WEIGHTS = "range", "choose", "weights"

WORLD = ("stage", "materials", "assets", "environment")
"""Sections whose values may be drawn; of the others, only the motion may."""

MOTION: Location = ("sensors", "motion")

SHORT = "a value, [least, most], a list of names, or {choose: [...]}"


@dataclass(frozen=True)
class RangeDraw:
    """A number that is drawn uniformly from a range.

    Attributes:
        ends: The least and the most.
        is_whole: Whether it is a whole number, of which both ends may be drawn.
    """

    ends: tuple[float, float]
    is_whole: bool = False

    @property
    def options(self) -> tuple[Any, ...]:
        """The values that are checked."""
        return self.ends

    def with_options(self, values: Sequence[Any]) -> RangeDraw:
        """Return the draw with other ends."""
        return RangeDraw((values[0], values[1]), self.is_whole)

    def to_data(self) -> dict[str, Any]:
        """Return the draw as it may stand in a configuration."""
        return {RANGE: list(self.ends)}

    def pick(self, rng: np.random.Generator) -> Any:
        """Return a number of the range."""
        least, most = self.ends
        if self.is_whole:
            return int(rng.integers(int(least), int(most), endpoint=True))
        return least if least == most else float(rng.uniform(least, most))


@dataclass(frozen=True)
class ChoiceDraw:
    """A value that is drawn from a list.

    Attributes:
        options: The values, each of which may hold draws itself.
        weights: How often each is drawn, relative to the others; empty: all equally.
    """

    options: tuple[Any, ...]
    weights: tuple[float, ...] = ()

    def with_options(self, values: Sequence[Any]) -> ChoiceDraw:
        """Return the draw with other values."""
        return ChoiceDraw(tuple(values), self.weights)

    def to_data(self) -> dict[str, Any]:
        """Return the draw as it may stand in a configuration."""
        weights = {WEIGHTS: list(self.weights)} if self.weights else {}
        return {CHOOSE: list(self.options), **weights}

    def pick(self, rng: np.random.Generator) -> Any:
        """Return one of the values."""
        return self.options[pick_index(len(self.options), self.weights, rng)]


Draw = RangeDraw | ChoiceDraw
Draws = dict[Location, Draw]


def pick_index(count: int, weights: Sequence[float], rng: np.random.Generator) -> int:
    """Return an index below ``count``, drawn by weights; without weights, uniformly."""
    if not weights:
        return int(rng.integers(count))
    ends = np.cumsum(weights)
    return min(int(np.searchsorted(ends, rng.uniform(0.0, ends[-1]), side="right")), count - 1)


def separate(data: Mapping[str, Any], kind: Any) -> tuple[dict[str, Any], Draws]:
    """Return data with one possible value instead of each draw, and the draws by location.

    Args:
        data: The data of a configuration.
        kind: The class of the configuration.

    Raises:
        InvalidInputError: A draw is malformed; the field is its location, with dots.
    """
    found: Draws = {}
    plain: dict[Any, Any] = dict(data)
    for name in WORLD:
        if name in plain:
            kinds = _kinds(inner_types(kind, name), plain[name])
            plain[name] = _separate(plain[name], kinds, (name,), found)
    sensors, motion = plain.get(MOTION[0]), str(MOTION[1])
    if isinstance(sensors, Mapping) and motion in sensors:
        sensor_kinds = _kinds(inner_types(kind, MOTION[0]), sensors)
        kinds = _kinds(_types_below(sensor_kinds, motion), sensors[motion])
        value = _separate(sensors[motion], kinds, MOTION, found)
        plain[str(MOTION[0])] = {**sensors, motion: value}
    return plain, found


def put_back(data: dict[str, Any], draws: Mapping[Location, Draw]) -> dict[str, Any]:
    """Return data with the draws at their locations; inverse: `separate`."""
    for location, draw in draws.items():
        put(data, location, draw.to_data())
    return data


def put(data: Any, location: Location, value: Any) -> None:
    """Set a value in nested mappings and lists, see `locate`; tuples on the way become lists."""
    *above, last = locate(data, location)
    for part in above:
        if isinstance(data[part], tuple):
            data[part] = list(data[part])
        data = data[part]
    data[last] = value


def value_at(data: Any, location: Location) -> Any:
    """Return a value in nested mappings and lists, see `locate`."""
    for part in locate(data, location):
        data = data[part]
    return data


def location_of(field: str) -> Location:
    """Return the keys and indices of a field's path: ``assets.groups.0`` has an index."""
    names = field.split(".")
    return tuple(name if (index := whole_of(name)) is None else index for name in names)


def locate(data: Any, location: Location) -> Location:
    """Return a location as it is in other data of the same configuration.

    One section may be given for a list of them, and JSON's keys are text.
    """
    found: list[int | str] = []
    for part in location:
        if isinstance(data, list | tuple) and not isinstance(part, int):
            found.append(0)
            data = data[0]
        if isinstance(data, Mapping) and part not in data:
            part = next((key for key in data if str(key) == str(part)), part)  # noqa: PLW2901
        found.append(part)
        data = data[part]
    return tuple(found)


def is_draw(value: object) -> bool:
    """Return whether a value is a draw that is written out."""
    if not isinstance(value, Mapping):
        return False
    is_choice = CHOOSE in value and set(value) <= {CHOOSE, WEIGHTS}
    # The key ``choose`` of ``environment.hdri`` holds a word.
    return set(value) == {RANGE} or (is_choice and not isinstance(value[CHOOSE], str))


def name_of(location: Location, data: Any) -> str:
    """Return a name for what is drawn at a location, in which names replace places in lists.

    So other draws do not change when a list of named things gets one more.
    """
    parts = []
    for part in location:
        data = data[part]
        name = data.get("name") if isinstance(part, int) and isinstance(data, Mapping) else None
        parts.append(name if isinstance(name, str) else str(part))
    return ".".join(parts)


def _separate(data: Any, kinds: list[Any], at: Location, found: Draws) -> Any:
    """Return data without draws, which are put into ``found``."""
    if not kinds:
        return data  # of another package, or an unknown key, which is refused later
    draw = _draw(data, kinds, at)
    if draw is not None:
        found[at] = draw
        # Draws inside of an option are found when that option is checked, and when it is drawn.
        return _separate(draw.options[0], _kinds(kinds, draw.options[0]), at, {})
    if isinstance(data, Mapping):
        return {key: _inner(value, kinds, at, key, found) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_inner(value, kinds, at, index, found) for index, value in enumerate(data)]
    return data


def _inner(value: Any, kinds: list[Any], at: Location, part: int | str, found: Draws) -> Any:
    """Return an entry without draws; what has no entries itself is none."""
    if not isinstance(value, list | tuple | Mapping):
        return value
    return _separate(value, _kinds(_types_below(kinds, part), value), (*at, part), found)


def _draw(data: Any, kinds: list[Any], at: Location) -> Draw | None:
    if is_draw(data):
        return _written_out(data, kinds, at)
    if not isinstance(data, list) or any(map(_takes_list, kinds)):
        return None
    if any((get_origin(kind) or kind) is dict for kind in kinds):
        return None  # things by name
    if any(not _is_number(each) for each in data):
        return ChoiceDraw(tuple(data))
    if len(data) != 2 or not {int, float} & set(kinds):
        raise InvalidInputError(_dotted(at), data, SHORT)
    return _range(data, kinds, at)


def _written_out(data: Mapping[str, Any], kinds: list[Any], at: Location) -> Draw:
    if RANGE in data:
        return _range(data[RANGE], kinds, (*at, RANGE))
    options, weights = data[CHOOSE], data.get(WEIGHTS, [])
    if not isinstance(options, list | tuple) or not options:
        raise InvalidInputError(_dotted((*at, CHOOSE)), options, "a list of values to choose from")
    sizes_fit = isinstance(weights, list | tuple) and len(weights) in (0, len(options))
    if not sizes_fit or not all(map(_is_weight, weights)):
        bounds = f"from {LEAST_WEIGHT:g} to {MOST_WEIGHT:g}"
        expected = f"{len(options)} numbers {bounds}, one for each value"
        raise InvalidInputError(_dotted((*at, WEIGHTS)), weights, expected)
    return ChoiceDraw(tuple(options), tuple(map(float, weights)))


def _range(data: Any, kinds: list[Any], at: Location) -> RangeDraw:
    is_pair = isinstance(data, list | tuple) and len(data) == 2 and all(map(_is_number, data))
    if not is_pair or data[0] > data[1]:
        raise InvalidInputError(_dotted(at), data, "[least, most], two finite numbers in order")
    if not _is_number(data[1] - data[0]):
        raise InvalidInputError(_dotted(at), data, "a range whose difference is a finite number")
    if not {int, float} & set(kinds):
        raise InvalidInputError(_dotted(at), data, "{choose: [...]}, because it is no number")
    return RangeDraw((data[0], data[1]), is_whole=float not in kinds)


def _kinds(types: Iterable[Any], data: Any) -> list[Any]:
    return [kind for each in types for kind in alternatives(each, data)]


def _types_below(kinds: list[Any], part: int | str) -> Iterator[Any]:
    for kind in kinds:
        yield from inner_types(kind, part)


def _takes_list(kind: Any) -> bool:
    if kind in (None, NoneType, Ellipsis):
        return False
    origin = get_origin(kind) or kind
    return origin is Any or (isinstance(origin, type) and issubclass(origin, list | tuple | set))


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= float_info.max


def _is_weight(value: object) -> bool:
    return _is_number(value) and LEAST_WEIGHT <= value <= MOST_WEIGHT  # type: ignore[operator]


def _dotted(location: Location) -> str:
    return ".".join(map(str, location))
