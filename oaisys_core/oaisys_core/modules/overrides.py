"""Metadata that overrides fields of a configuration section, under the section's own checks."""

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

    Mappings inside are merged key by key, as `ModuleMetadata.updated` does.

    Raises:
        InvalidInputError: A key is unknown or a value does not fit; its path starts with
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
    """Return, as JSON-able data, the fields of ``changed`` with which `overridden` makes it."""
    if changed is section:
        return {}
    before, after = section.model_dump(mode="json"), changed.model_dump(mode="json")
    return {name: value for name, value in after.items() if value != before[name]}


class SectionModule(Module, Generic[SectionT]):
    """A module that is a configuration section, any field of which a step may override.

    A batch begins with the configured values; a sample's changes hold until the next batch.
    """

    def __init__(self, config: SectionT) -> None:
        self._config = config
        self._now = config

    @abstractmethod
    def apply(self, world: World, section: SectionT) -> None:
        """Put what the section says into the world."""

    def check(self, metadata: Metadata) -> None:
        """Refuse unknown keys and values out of range."""
        overridden(self._now, metadata, self.metadata_part)

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Begin a batch with the configuration and the metadata's changes."""
        self._now = overridden(self._config, metadata, self.metadata_part)
        self.apply(world, self._now)

    def in_force(self, metadata: Metadata) -> Metadata:
        """Return the fields that differ from the configuration.

        Mappings are merged key by key, so that a field set to null and then to a mapping has what
        the configuration says no more; all metadata merged would bring that back.
        """
        return differing(self._config, self._now)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Change what the metadata says, for this and the following samples."""
        self._now = overridden(self._now, metadata, self.metadata_part)
        self.apply(world, self._now)
