"""Simulation modules that other packages add, each with its own options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import ValidationError

from oaisys_core import extensions
from oaisys_core.config.expectations import faults_of
from oaisys_core.config.section import Section
from oaisys_core.errors import ConfigError, quote
from oaisys_core.world.module import Module

BUILT_IN = frozenset(
    {"stage", "materials", "assets", "asset", "environment", "sensors", "sensor", "render"}
)


class NoOptions(Section):
    """The options of a module without options."""


class ExtensionModule(Module):
    """Base of the modules that other packages register under a name.

    It runs after the built-in modules, receives ``metadata.custom[name]``, and has its own random
    stream, so that it does not change what other modules draw.

    Attributes:
        options: The checked options from ``extensions.<name>`` in the configuration.
    """

    options_type: ClassVar[type[Section]] = NoOptions

    def __init__(self, options: Section) -> None:
        self.options = options
        self.metadata_part = self.name


def make_modules(configured: Mapping[str, Mapping[str, Any]]) -> tuple[ExtensionModule, ...]:
    """Return the modules that a configuration lists in ``extensions``, sorted by name.

    Raises:
        ConfigError: There is no such module, it cannot be imported, or an option is invalid.
    """
    return tuple(_make(name, options) for name, options in sorted(configured.items()))


def _make(name: str, options: Mapping[str, Any]) -> ExtensionModule:
    if name in BUILT_IN:
        raise ConfigError(
            f"extensions.{name}: expected a name other than those of the built-in modules"
        )
    kind = extensions.load(extensions.MODULES, name)
    if not (isinstance(kind, type) and issubclass(kind, ExtensionModule)):
        raise ConfigError(f"extensions.{name}: received {quote(kind)}, expected an ExtensionModule")
    if kind.name != name:
        raise ConfigError(
            f"extensions.{name}: its class has the name {quote(kind.name)}, expected the same name"
        )
    try:
        return kind(kind.options_type.model_validate(dict(options)))
    except ValidationError as error:
        faults = [
            ".".join(("extensions", name, *map(str, fault.location)))
            + f": received {quote(fault.received)}, expected {fault.expected}{fault.hint}"
            for fault in faults_of(error, options, kind.options_type)
        ]
        raise ConfigError("\n".join(faults)) from error
