"""The base class of configuration sections, and the types that they share."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import hypot, inf, isfinite
from typing import Annotated, Any, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from oaisys_core.errors import quote
from oaisys_core.geometry import MAX_M, expect_unit_norm

Vector3 = tuple[float, float, float]
SemanticId = Annotated[int, Field(ge=0, le=65535)]
Positive = Annotated[float, Field(gt=0)]
LEAST_RATE_HZ = 1e-4
"""Of measurements: with far lower ones, 64 bits do not hold their times in nanoseconds."""
LEAST_WEIGHT, MOST_WEIGHT = 1e-12, 1e12
"""Of weights, whose sum must be a number that one can draw by."""

Weight = Annotated[float, Field(ge=LEAST_WEIGHT, le=MOST_WEIGHT)]
Longitude = Annotated[float, Field(ge=-180, le=360)]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Metres = Annotated[float, Field(ge=-MAX_M, le=MAX_M)]
Position = tuple[Metres, Metres, Metres]
PlaceInDegrees = tuple[Longitude, Latitude] | tuple[Longitude, Latitude, Metres]
"""(longitude, latitude) or (longitude, latitude, elevation in m); east and north are positive."""

MAX_LABEL_LETTERS = 1000


def _in_a_line(text: str) -> str:
    if len(text) > MAX_LABEL_LETTERS or not text.isprintable():
        limit = f"at most {MAX_LABEL_LETTERS} letters"
        raise ValueError(f"expected text of {limit} in a line, without control characters")
    return text


LabelText = Annotated[str, AfterValidator(_in_a_line)]
"""A label, which data sets and legends show in a line."""

MIN_SIZE_M = 1e-4
"""Smallest size, with whose squares and inverse one can compute."""

Size = Annotated[float, Field(ge=MIN_SIZE_M, le=MAX_M)]
"""A size in metres."""

LEAST_TILE_M = 0.01
"""Smallest edge of a texture's tile: coordinates in tiles far away must be more than noise."""

TileEdge = Annotated[float, Field(ge=LEAST_TILE_M, le=MAX_M)]
"""Edge of a texture's tile in metres."""

Scale = Annotated[float, Field(ge=1e-6, le=1e6)]
"""A factor on a size."""


def _pair(value: Any) -> Any:
    """Return a number twice, also one that YAML 1.1 takes for text, such as ``1e3``."""
    if isinstance(value, str):
        with suppress(ValueError):
            value = float(value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value, value
    if isinstance(value, list | tuple):
        return value
    raise ValueError("expected a number or [least, most]")


def _in_order(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError("expected [least, most]")
    if not isfinite(value[1] - value[0]):
        raise ValueError("expected [least, most] whose difference is a finite number")
    return value


class OneForBoth:
    """Marks a pair of numbers for both of which a single one may stand."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Repeat a single number before the pair is checked."""
        either = handler.generate_schema(get_args(source)[0] | source)
        return core_schema.no_info_before_validator_function(
            _pair, handler(source), json_schema_input_schema=either
        )


Range = Annotated[tuple[float, float], OneForBoth(), AfterValidator(_in_order)]
"""Range ``[least, most]`` of a random value; a single number stands for both."""

PositiveRange = Annotated[tuple[Positive, Positive], OneForBoth(), AfterValidator(_in_order)]


@dataclass(frozen=True)
class Within:
    """Marks a `Range` whose ends must lie between ``least`` and ``most``."""

    least: float = -inf
    most: float = inf

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Check after the range itself, so that errors refer to the whole field."""
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Add the limits to the schema of a single number and of both ends."""
        limits = {"minimum": self.least, "maximum": self.most}
        number = {"type": "number"} | {k: v for k, v in limits.items() if abs(v) != inf}
        pair = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
        return {"anyOf": [number, pair]}

    def _check(self, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] < self.least or value[1] > self.most:
            least, most = f"{self.least:g}", f"{self.most:g}"
            bounds = f"of at least {least}" if self.most == inf else f"from {least} to {most}"
            raise ValueError(f"expected numbers {bounds}")
        return value


TileRange = Annotated[Range, Within(LEAST_TILE_M, MAX_M)]
"""Range of edges of a texture's tile in metres."""


class ByKind:
    """Marks a union of sections whose ``kind`` selects one of them.

    Without a ``kind`` it is the section whose ``kind`` has a default, if there is one.
    """

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Fill in the default kind before one of the sections is selected."""
        union = handler.generate_schema(Annotated[source, Field(discriminator="kind")])
        kinds = [part.model_fields["kind"] for part in get_args(source)]
        defaults = [kind.default for kind in kinds if not kind.is_required()]
        if not defaults:
            return union
        (default,) = defaults

        def with_kind(data: Any) -> Any:
            is_without = isinstance(data, Mapping) and "kind" not in data
            return {"kind": default, **data} if is_without else data

        return core_schema.no_info_before_validator_function(with_kind, union)


NotNegative = Annotated[Range, Within(least=0.0)]

Brightness = Annotated[Range, Within(0.0, 1e6)]
"""Range of irradiances, or of factors on radiance: pictures add them up in float32."""

MAX_LEVELS = 10
"""Semantic levels: ``semantic_0`` to ``semantic_9``."""


def _check_norm(quat_xyzw: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if expected := expect_unit_norm(hypot(*quat_xyzw)):
        raise ValueError(f"expected {expected}")
    return quat_xyzw


Quaternion = Annotated[tuple[float, float, float, float], AfterValidator(_check_norm)]
"""Unit quaternion (x, y, z, w), kept as it was typed; who uses it normalises it."""


def _has_truth_value(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_has_truth_value, value))
    return isinstance(value, bool)


def _takes_truth_value(section: type[BaseModel], name: str) -> bool:
    """Return whether a field may be true or false, or there is none, which others refuse."""
    field = section.model_fields.get(name)
    kinds = repr(field and field.annotation)
    return field is None or "bool" in kinds or "Any" in kinds


class Section(BaseModel):
    """Base of all sections; it refuses unknown keys, numbers not finite, and truth as numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _check_truth_values(cls, data: Any) -> Any:
        """Refuse true and false, which YAML also reads from yes, no, on and off, as numbers."""
        for name, value in data.items() if isinstance(data, dict) else ():
            if _has_truth_value(value) and not _takes_truth_value(cls, name):
                raise ValueError(f"{name} is {quote(value)}, expected no truth value")
        return data


class LabelConfig(Section):
    """A name and its semantic id; an id must have the same name in the whole configuration.

    Attributes:
        label: Name of the label.
        semantic_id: Its id; 0 means unlabelled.
    """

    label: LabelText
    semantic_id: SemanticId


class Labelled(Section):
    """The labels of an object on all semantic levels.

    Attributes:
        label: Name on level 0.
        semantic_id: Id on level 0.
        levels: Labels on the levels from 1 on; further levels are unlabelled (0).
    """

    label: LabelText
    semantic_id: SemanticId
    levels: tuple[LabelConfig, ...] = Field(default=(), max_length=MAX_LEVELS - 1)

    @property
    def semantic_ids(self) -> tuple[int, ...]:
        """Ids from level 0 on."""
        return (self.semantic_id, *(level.semantic_id for level in self.levels))

    @property
    def labels(self) -> dict[int, str]:
        """Names by id."""
        names = {level.semantic_id: level.label for level in self.levels}
        return {self.semantic_id: self.label} | names
