"""The figures of ``oaisys audit --light`` that a certificate carries."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json, read_text
from oaisys_core.types import SimulatorInfo
from oaisys_core.verification.light.light_figure import LightFigure

OPTION = "--light"
NUMBERS = ("measured", "expected", "limit")
USUAL_LIMIT = 0.03
"""The largest relative error that the audit itself allows for any of its figures."""


@dataclass(frozen=True)
class LightAudit:
    """An audit of light.

    Attributes:
        backend, backend_version: Of the renderer that was audited.
        figures: At least one.
    """

    backend: str
    backend_version: str
    figures: tuple[LightFigure, ...]

    @property
    def command(self) -> str:
        """The command that measures the figures."""
        return f"oaisys audit --light --backend {self.backend} --out light.json"

    @property
    def worst(self) -> LightFigure:
        """The figure whose error is the largest share of its limit."""
        return max(self.figures, key=lambda each: abs(each.error) / each.limit)

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON values; inverse: `light_from_json`."""
        return {
            "command": self.command,
            **asdict(self),
            "figures": [asdict(f) for f in self.figures],
        }

    def check_renderer(self, info: SimulatorInfo) -> None:
        """Raise `InvalidInputError` if a simulator has another renderer than the one audited."""
        audited, ours = (self.backend, self.backend_version), (info.backend, info.backend_version)
        if audited != ours:
            expected = f"figures of {' '.join(ours)}, which renders: run `oaisys audit --light`"
            raise InvalidInputError(OPTION, " ".join(audited), expected)


def read_light_audit(path: Path) -> LightAudit:
    """Return the figures that ``oaisys audit --light --out FILE`` has written.

    Raises:
        InvalidInputError: The file cannot be read, or is something else.
    """
    try:
        records = parse_json(read_text(path))
    except (OSError, ValueError) as error:
        raise InvalidInputError(OPTION, str(path), f"a file of figures ({error})") from error
    try:
        renderers = {(each["backend"], each["backend_version"]) for each in records}
        ((backend, version),) = renderers
    except (KeyError, TypeError, ValueError):
        expected = "figures of one renderer, as `oaisys audit --light --out FILE` writes them"
        raise InvalidInputError(OPTION, str(path), expected) from None
    values = {"backend": backend, "backend_version": version, "figures": records}
    return light_from_json(values, f"{OPTION} {path}")


def light_from_json(values: Mapping[str, Any], where: str) -> LightAudit:
    """Return an audit from JSON values; ``where`` names them in errors.

    Raises:
        InvalidInputError: They are incomplete, or not finite.
    """
    try:
        figures = tuple(
            LightFigure(str(each["name"]), *(_number(each[key]) for key in NUMBERS))
            for each in values["figures"]
        )
        audit = LightAudit(str(values["backend"]), str(values["backend_version"]), figures)
    except (KeyError, TypeError, ValueError) as error:
        expected = f"figures with name, {', '.join(NUMBERS)}, of a backend"
        raise InvalidInputError(where, str(error), expected) from error
    if not figures or any(f.expected == 0 or f.limit <= 0 for f in figures):
        raise InvalidInputError(where, f"{len(figures)} figures", "at least one, none of 0")
    return audit


def _number(value: object) -> float:
    number = float(value) if isinstance(value, int | float) else math.nan
    if not math.isfinite(number):
        raise ValueError(f"received {value!r}, expected a finite number")
    return number
