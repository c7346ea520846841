"""Modules of other packages: further parts of a simulation, each with options of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import ValidationError

from oaisys_core import extensions
from oaisys_core.config.expectations import faults_of
from oaisys_core.config.section import Section
from oaisys_core.errors import ConfigError
from oaisys_core.module import Module

BUILT_IN = frozenset(
    {"stage", "materials", "assets", "asset", "environment", "sensors", "sensor", "render"}
)


class NoOptions(Section):
    """Options of a module that has none."""


class ExtensionModule(Module):
    """Base of modules of other packages, registered under their names.

    It runs after the built-in modules, is given ``metadata.custom[name]``, and draws from a stream
    of its own: with or without it, everything else is drawn as before.

    Attributes:
        options: As the configuration gives them in ``extensions.<name>``, checked.
    """

    options_type: ClassVar[type[Section]] = NoOptions

    def __init__(self, options: Section) -> None:
        self.options = options
        self.metadata_part = self.name


def make_modules(configured: Mapping[str, Mapping[str, Any]]) -> tuple[ExtensionModule, ...]:
    """Return the modules that a configuration's ``extensions`` name, in the order of their names.

    Raises:
        ConfigError: There is no such module, it cannot be imported, or an option does not fit.
    """
    return tuple(_made(name, options) for name, options in sorted(configured.items()))


def _made(name: str, options: Mapping[str, Any]) -> ExtensionModule:
    if name in BUILT_IN:
        raise ConfigError(f"extensions.{name}: expected a name that no built-in module has")
    kind = extensions.load(extensions.MODULES, name)
    if not (isinstance(kind, type) and issubclass(kind, ExtensionModule)):
        raise ConfigError(f"extensions.{name}: received {kind!r}, expected an ExtensionModule")
    if kind.name != name:
        raise ConfigError(f"extensions.{name}: its class calls itself {kind.name!r}")
    try:
        return kind(kind.options_type.model_validate(dict(options)))
    except ValidationError as error:
        faults = [
            ".".join(("extensions", name, *map(str, fault.location)))
            + f": received {fault.received!r}, expected {fault.expected}"
            for fault in faults_of(error, options)
        ]
        raise ConfigError("\n".join(faults)) from error
