"""Limits of numbers that may be given as ranges."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from oaisys_core.config.section import Range


@dataclass(frozen=True)
class Within:
    """Marks a `Range` both of whose ends must lie within ``least`` and ``most``."""

    least: float = -inf
    most: float = inf

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Check after the range itself, so that a fault is told of the field as a whole."""
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Tell the limits of a number alone and of both ends."""
        limits = {"minimum": self.least, "maximum": self.most}
        number = {"type": "number"} | {k: v for k, v in limits.items() if abs(v) != inf}
        pair = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
        return {"anyOf": [number, pair]}

    def _checked(self, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] < self.least or value[1] > self.most:
            raise ValueError(f"expected numbers from {self.least:g} to {self.most:g}")
        return value


NotNegative = Annotated[Range, Within(least=0.0)]
