"""Loading of YAML files and mappings as a checked `SimulationConfig`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from oaisys_core.config.draws import location_of
from oaisys_core.config.expectations import (
    MISSING_KEY,
    UNKNOWN_KEY,
    WORDS,
    ConfigFault,
    fault_count,
    faults_of,
)
from oaisys_core.config.model import SimulationConfig
from oaisys_core.errors import ConfigError, quote, show_field
from oaisys_core.files.canonical_json import canonical_text, text_sha256
from oaisys_core.files.documents import DocumentError, read_text
from oaisys_core.files.path_fields import BASE
from oaisys_core.files.yaml_documents import parse_yaml_with_lines

if TYPE_CHECKING:
    import yaml

_WORD = re.compile(r"\w{2,}")


def load_config(path: Path) -> SimulationConfig:
    """Return the configuration in a YAML file; an empty file gives the default world.

    Relative paths in it start from the folder of the file.

    Raises:
        ConfigError: One line per error: file, line, path, value received, what was expected.
    """
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    try:
        data, root = parse_yaml_with_lines(text)
    except DocumentError as error:
        raise ConfigError(f"{path}: is not YAML that can be used: {error}") from error
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: received a {type(data).__name__}, expected a mapping")
    return _check(data, base=path.parent, source=str(path), root=root)


def config_from_mapping(data: Mapping[str, Any], base: Path = Path()) -> SimulationConfig:
    """Return the configuration in a plain mapping.

    Raises:
        ConfigError: One line per error.
    """
    return _check(data, base=base, source="config", root=None)


def with_lines(path: Path, faults: Iterable[str]) -> list[str]:
    """Return errors that start with a path, with file and line in front of them."""
    _, root = parse_yaml_with_lines(read_text(path))
    lines = []
    for fault in faults:
        line = _line_of(root, location_of(fault.partition(":")[0]))
        lines.append(f"{path}: {fault}" if line is None else f"{path}:{line}: {fault}")
    return lines


def canonical_json(config: SimulationConfig) -> str:
    """Return the complete configuration, defaults included, in canonical form.

    Paths in it are absolute, except for ``stage.store`` and ``output.folder``.
    """
    return canonical_text(config.model_dump(mode="json"))


def config_sha256(config: SimulationConfig) -> str:
    """Return the hash of a configuration's canonical JSON form."""
    return text_sha256(canonical_json(config))


def _check(
    data: Mapping[str, Any], base: Path, source: str, root: yaml.Node | None
) -> SimulationConfig:
    try:
        config = SimulationConfig.model_validate(data, context={BASE: base})
    except ValidationError as error:
        lines = [_line(fault, source, root) for fault in faults_of(error, data, SimulationConfig)]
        if (count := fault_count(error, data)) > len(lines):
            lines.append(f"{source}: {count - len(lines)} more errors, {count} in all")
        raise ConfigError("\n".join(lines)) from error
    return config


def _line(fault: ConfigFault, source: str, root: yaml.Node | None) -> str:
    line = _line_of(root, fault.location)
    where = source if line is None else f"{source}:{line}"
    path = show_field(fault.path) or "(whole file)"
    if fault.kind == UNKNOWN_KEY:
        return f"{where}: {path}: unknown key, expected {fault.expected}"
    if fault.kind == MISSING_KEY:
        expected = "a value" if fault.expected == WORDS[MISSING_KEY] else fault.expected
        return f"{where}: {path}: missing, expected {expected}"
    received = f"received {quote(fault.received)}"
    if fault.statement is None:
        return f"{where}: {path}: {received}, expected {fault.expected}{fault.hint}"
    if isinstance(fault.received, Mapping):
        return f"{where}: {path}: {_with_values(fault.statement, fault.received)}"
    return f"{where}: {path}: {received}: {fault.statement}"


def _with_values(statement: str, section: Mapping[Any, Any]) -> str:
    """Return a statement about a section, with the values of the keys that it names.

    The whole section would be too long.
    """
    named = {word: quote(section[word]) for word in _WORD.findall(statement) if word in section}
    shown = [f"{key} {value}" for key, value in named.items() if value not in statement]
    return f"{statement} (received {', '.join(shown)})" if shown else statement


def _line_of(node: yaml.Node | None, loc: Iterable[int | str]) -> int | None:
    """Return the line (from 1) of the deepest node of a path that is in the file."""
    import yaml

    if node is None:
        return None
    for part in loc:
        child: yaml.Node | None = None
        if isinstance(node, yaml.MappingNode):
            child = next((v for k, v in node.value if k.value == part), None)
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            child = node.value[part] if part < len(node.value) else None
        if child is None:
            break
        node = child
    return node.start_mark.line + 1
