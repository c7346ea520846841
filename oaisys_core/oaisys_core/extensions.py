"""What other packages add, found by their entry points.

A package names a thing in one of the groups below; a configuration then uses it by that name. What
is not asked for is never imported, and a thing that cannot be imported stops nobody else's.

* `MODULES`: a `Module` subclass whose ``name`` is the entry point's; see `make_modules`.
* `STAGES`: a function ``(GroundSpec, Generator) -> elevation``, used as ``stage.preset``.
* `SCATTERERS`: a function ``(Generator) -> MeshPrototype``, used as a ``shape``.
* `PASSES`: a `GeometryPass` subclass, used as a modality.
* `EFFECTS`: an `EnvironmentEffect` subclass, used in ``environment.effects``.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from oaisys_core.errors import ConfigError, one_of

MODULES = "oaisys.modules"
STAGES = "oaisys.stages"
SCATTERERS = "oaisys.scatterers"
PASSES = "oaisys.passes"
EFFECTS = "oaisys.environment_effects"


def names(group: str) -> set[str]:
    """Return what is installed in a group, whether it can be imported or not."""
    return {entry.name for entry in entry_points(group=group)}


def is_installed(group: str, name: str, built_in: Collection[str]) -> bool:
    """Return whether another package has a thing of that name; built-in ones come first."""
    return name not in built_in and name in names(group)


@cache
def load(group: str, name: str) -> Any:
    """Return an installed thing.

    Raises:
        ConfigError: There is none, there are two, or it cannot be imported; names the package.
    """
    found = list({entry.value: entry for entry in entry_points(group=group, name=name)}.values())
    if not found:
        known = one_of(names(group), name)
        raise ConfigError(f"{group}: received {name!r}, expected an installed one: {known}")
    if len(found) > 1:
        told = " and ".join(_told(entry) for entry in found)
        raise ConfigError(f"{group}: {name!r} is ambiguous: {told}")
    try:
        return found[0].load()
    # A broken package may raise anything when it is imported.
    except Exception as error:
        text = f"{group}: {_told(found[0])} cannot be imported: {error!r}"
        raise ConfigError(text) from error


def _told(entry: EntryPoint) -> str:
    package = entry.dist.name if entry.dist is not None else "an unknown package"
    return f"{entry.name!r} of {package} ({entry.value})"
