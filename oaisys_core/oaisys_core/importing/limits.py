"""Values of the original beyond what we, or Blender, can have: clamped, and told by their key."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import inf
from typing import Any

from pydantic import ValidationError

from oaisys_core.config import SimulationConfig
from oaisys_core.config.expectations import ConfigFault, faults_of
from oaisys_core.errors import ConfigError, quote
from oaisys_core.importing.document import Json
from oaisys_core.importing.key_outcomes import KeyOutcome

_ROUNDS = 20
"""Of validation; each finds all errors that it can."""

Bounds = tuple[float, float]


def clamp(config: Json, outcomes: Mapping[str, KeyOutcome], source: str) -> list[str]:
    """Clamp numbers beyond their bounds in place, and return one warning for each.

    Args:
        config: Our configuration, as plain data.
        outcomes: What became of each key in the original.
        source: Name of the file in errors.

    Raises:
        ConfigError: A value cannot be mended; it names the original's key, where one is known.
    """
    warnings: list[str] = []
    for _ in range(_ROUNDS):
        faults = _faults(config)
        told = [_clamp_one(config, fault, outcomes) for fault in faults]
        if None in told:
            lines = [_refusal(fault, outcomes, source) for fault in faults]
            raise ConfigError("\n".join(lines))
        warnings.extend(text for text in told if text)
        if not faults:
            break
    return list(dict.fromkeys(warnings))


def _faults(config: Json) -> list[ConfigFault]:
    try:
        # Whether files exist, and statements about several keys, are for the check that follows.
        SimulationConfig.model_validate(config)
    except ValidationError as error:
        return faults_of(error, config, SimulationConfig)
    return []


def _clamp_one(config: Json, fault: ConfigFault, outcomes: Mapping[str, KeyOutcome]) -> str | None:
    """Clamp a value, and return the warning; None if it has no bounds or is no number."""
    place: Any = config
    for part in fault.location[:-1]:
        place = place[part]
    last = fault.location[-1] if fault.location else None
    value, bounds = fault.received, _bounds(fault)
    if bounds is None or last is None or not _is_number_or_range(value):
        return None
    clamped = _within(value, bounds)
    if clamped == value:
        return None
    place[last] = clamped
    words = f"{value} becomes {clamped}, as {fault.path} has {fault.expected}"
    return f"{_keys(fault, outcomes)}: {words}"


def _is_number_or_range(value: object) -> bool:
    each = value if isinstance(value, list | tuple) else [value]
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in each)


def _within(value: Any, bounds: Bounds) -> Any:
    if isinstance(value, list | tuple):
        return [_within(each, bounds) for each in value]
    least, most = bounds
    # Numbers keep their type: counts are whole.
    return type(value)(min(max(value, least), most))


def _bounds(fault: ConfigFault) -> Bounds | None:
    """Return the bounds that an error says were missed."""
    found = re.fullmatch(r"numbers from (\S+) to (\S+)", fault.expected)
    if found:
        return float(found[1]), float(found[2])
    found = re.fullmatch(r"a number of at (least|most) (\S+)", fault.expected)
    if found is None:
        return None
    limit = float(found[2])
    return (limit, inf) if found[1] == "least" else (-inf, limit)


def _keys(fault: ConfigFault, outcomes: Mapping[str, KeyOutcome]) -> str:
    """Return the original's keys that were mapped to a field, or our path where none is known."""
    names = [str(part) for part in fault.location if not isinstance(part, int)]
    plain = ".".join(names)
    if not plain:
        return "(whole file)"
    found = [
        key
        for key, outcome in outcomes.items()
        if outcome.kind == "mapped" and (plain in outcome.text or _ends(outcome.text, names))
    ]
    return " or ".join(found) or fault.path


def _ends(text: str, names: list[str]) -> bool:
    return len(names) > 1 and f"{names[0]}." in text and names[-1] in text


def _refusal(fault: ConfigFault, outcomes: Mapping[str, KeyOutcome], source: str) -> str:
    wanted = fault.statement or f"received {quote(fault.received)}, expected {fault.expected}"
    place = f" ({fault.path})" if fault.path else ""
    return f"{source}: {_keys(fault, outcomes)}: {wanted}{place}"
