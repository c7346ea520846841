"""Reading of original configuration files, and the paths of their keys."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from oaisys_core.errors import ConfigError
from oaisys_core.files.documents import parse_json, read_text

Json = dict[str, Any]

MODULES = {
    "RENDER_SETUP.RENDER_PASSES": "passParams",
    "SENSOR_SETUP.SENSORS": "sensorParams",
    "ENVIRONMENT_EFFECTS_SETUP.ENVIRONMENT_EFFECTS": "environmentEffectsParams",
}
SECTIONS = (
    "SIMULATION_SETUP",
    "RENDER_SETUP",
    "RENDER_POST_PROCESSING_EFFECTS_SETUP",
    "SENSOR_SETUP",
    "ENVIRONMENT_EFFECTS_SETUP",
    "ASSET_SETUP",
)


def load_document(path: Path) -> Json:
    """Return the data of an original configuration file.

    Raises:
        ConfigError: It cannot be read, or is not an original configuration.
    """
    try:
        data = parse_json(read_text(path))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: is not a readable JSON file: {error}") from error
    if not isinstance(data, dict) or not set(SECTIONS) & set(data):
        raise ConfigError(f"{path}: expected sections such as {', '.join(SECTIONS[:3])}")
    return data


def key_paths(node: Any, at: str = "") -> Iterator[str]:
    """Yield the dotted paths of all keys with values, without the indices of lists.

    A mapping inside a list of values is part of the value.
    """
    if isinstance(node, Mapping) and node:
        for key, value in node.items():
            yield from key_paths(value, f"{at}.{key}".removeprefix("."))
    elif isinstance(node, Sequence) and node and all(isinstance(v, Mapping) for v in node):
        for value in node:
            yield from key_paths(value, at)
    elif at and not _is_empty(node):
        yield at


def part(node: Mapping[str, Any], *keys: str) -> Json:
    """Return a nested mapping, or an empty one if it is missing."""
    found: Any = node
    for key in keys:
        found = found.get(key, {}) if isinstance(found, Mapping) else {}
    return dict(found) if isinstance(found, Mapping) else {}


def entries(node: Mapping[str, Any], *keys: str) -> list[Json]:
    """Return the mappings in a nested list."""
    found = part(node, *keys[:-1]).get(keys[-1]) or []
    return [dict(entry) for entry in found if isinstance(entry, Mapping)]


def span(value: Any, default: Sequence[float] = (0.0, 0.0)) -> list[float]:
    """Return a number or a list of one or two numbers as [least, most]."""
    if value is None:
        value = default
    numbers = list(value) if isinstance(value, Sequence) else [value]
    return sorted((float(numbers[0]), float(numbers[-1])))


def _is_empty(node: Any) -> bool:
    return isinstance(node, Mapping | list) and not node
