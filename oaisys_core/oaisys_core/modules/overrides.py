"""Metadata that overrides fields of a configuration section, with the section's own checks."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Generic, TypeVar

import numpy as np
from pydantic import ValidationError

from oaisys_core.config.expectations import refusal
from oaisys_core.config.section import Section
from oaisys_core.module import Metadata, Module, World
from oaisys_core.types import merged

SectionT = TypeVar("SectionT", bound=Section)


def overridden(section: SectionT, metadata: Metadata, part: str) -> SectionT:
    """Return ``section`` with the fields in ``metadata`` replaced.

    Nested mappings are merged key by key, as in `ModuleMetadata.updated`.

    Raises:
        InvalidInputError: A key is unknown or a value is invalid; its path starts with
            ``metadata.{part}``.
    """
    if not metadata:
        return section
    data = merged(section.model_dump(), metadata)
    try:
        return type(section).model_validate(data)
    except ValidationError as error:
        known = sorted(type(section).model_fields)
        raise refusal(error, data, "metadata", part, known_keys=known) from error


def differing(section: Section, changed: Section) -> dict[str, Any]:
    """Return, as JSON-compatible data, the fields that `overridden` needs to make ``changed``."""
    if changed is section:
        return {}
    before, after = section.model_dump(mode="json"), changed.model_dump(mode="json")
    return {name: value for name, value in after.items() if value != before[name]}


class SectionModule(Module, Generic[SectionT]):
    """A module whose configuration section may be overridden, field by field, at each step.

    A batch starts with the configured values; changes by a sample last until the next batch.
    """

    def __init__(self, config: SectionT) -> None:
        self._config = config
        self._now = config

    @abstractmethod
    def apply(self, world: World, section: SectionT) -> None:
        """Apply the section to the world."""

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys and invalid values."""
        overridden(self._now, metadata, self.metadata_part)

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Start a batch with the configuration, changed by the metadata."""
        self._now = overridden(self._config, metadata, self.metadata_part)
        self.apply(world, self._now)

    def in_force(self, metadata: Metadata) -> Metadata:
        """Return the fields that differ from the configuration.

        Merged metadata would be wrong: if a field was set to null and then to a mapping, the merge
        would bring back the configured keys of that field.
        """
        return differing(self._config, self._now)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Apply the metadata to this and the following samples."""
        self._now = overridden(self._now, metadata, self.metadata_part)
        self.apply(world, self._now)
