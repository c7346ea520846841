"""Extensions of other packages, found by their entry points.

A package registers an extension in one of the groups below; a configuration, or an option of a
command, uses it by its name.
Extensions are imported only when they are used, so a broken one does not affect the others.

* `MODULES`: a `Module` subclass whose ``name`` is the entry point's; see `make_modules`.
* `STAGES`: a function ``(GroundSpec, Generator) -> elevation``, used as ``stage.preset``.
* `SCATTERERS`: a function ``(Generator) -> MeshPrototype``, used as a ``shape``.
* `PASSES`: a `GeometryPass` subclass, used as a modality.
* `EFFECTS`: an `EnvironmentEffect` subclass, used in ``environment.effects``.
* `DATASET_FORMATS`: a `DatasetFormat` subclass, used by ``oaisys dataset export --format``.
* `POSE_READERS`: a function ``(Path, PoseSelection) -> PoseTable``; ``mcap`` reads
  the poses of bags.
* `DRIVE_RECORDERS`: a function ``(DriveDescription) -> DriveRecorder``; ``bag`` is used by ``oaisys
  drive``.
* `DRIVE_REPORTS`: a function ``(RecordedDrive, Callable[[str], None]) -> Path`` that writes a
  report and may say what it does; ``html`` is used by ``oaisys drive``.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from oaisys_core.errors import ConfigError, ShortageError, one_of, quote

MODULES = "oaisys.modules"
STAGES = "oaisys.stages"
SCATTERERS = "oaisys.scatterers"
PASSES = "oaisys.passes"
EFFECTS = "oaisys.environment_effects"
DATASET_FORMATS = "oaisys.dataset_formats"
POSE_READERS = "oaisys.pose_readers"
DRIVE_RECORDERS = "oaisys.drive_recorders"
DRIVE_REPORTS = "oaisys.drive_reports"


def names(group: str) -> set[str]:
    """Return the names of all extensions in a group, whether they can be imported or not."""
    return {entry.name for entry in entry_points(group=group)}


def is_installed(group: str, name: str, built_in: Collection[str]) -> bool:
    """Return whether an extension has this name and nothing built in has it."""
    return name not in built_in and name in names(group)


@cache
def load(group: str, name: str) -> Any:
    """Import and return an extension.

    Raises:
        ConfigError: There is none, there are several, or it cannot be imported. The message names
            the package.
        ShortageError: The machine lacks what it needs, as it says itself.
    """
    found = list({entry.value: entry for entry in entry_points(group=group, name=name)}.values())
    if not found:
        known = one_of(names(group), name)
        raise ConfigError(f"{group}: received {quote(name)}, expected an installed one: {known}")
    if len(found) > 1:
        candidates = " and ".join(_describe(entry) for entry in found)
        raise ConfigError(f"{group}: {quote(name)} is ambiguous: {candidates}")
    try:
        return found[0].load()
    except ShortageError:  # of the machine, which says nothing about the package
        raise
    # A broken package may raise anything when it is imported.
    except Exception as error:
        text = f"{group}: {_describe(found[0])} cannot be imported: {quote(error)}"
        raise ConfigError(text) from error


def _describe(entry: EntryPoint) -> str:
    package = entry.dist.name if entry.dist is not None else "an unknown package"
    return f"{quote(entry.name)} of {package} ({entry.value})"
