"""Variants of a configuration, of which each world is drawn from one."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, StringConstraints

from oaisys_core.config.draws import MOTION, WORLD, is_draw
from oaisys_core.config.section import Section, Weight
from oaisys_core.files.path_fields import ConfigFile

SECTIONS = (*WORLD, "motion")
"""What a variant may have of its own."""

_LOG = logging.getLogger(__name__)


class VariantConfig(Section):
    """Worlds of another kind in the same data set; cameras and all else are those of the file.

    Attributes:
        name: Its name, which the manifests of data sets have.
        weight: How often a world is of this variant, relative to the other variants.
        file: Configuration file whose stage, materials, assets, environment and motion it has,
            relative to this one; its other keys are not used.
        is_whole: Whether its sections replace those of this file (or of ``file``) entirely, instead
            of changing them key by key.
        stage, materials, assets, environment: The section, with the keys that differ.
        motion: The motion of its views, instead of `sensors.motion`.
    """

    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    weight: Weight = 1.0
    file: ConfigFile | None = None
    is_whole: bool = False
    stage: dict[str, Any] | None = None
    materials: dict[str, Any] | None = None
    assets: dict[str, Any] | None = None
    environment: dict[str, Any] | None = None
    motion: dict[str, Any] | None = Field(default=None)

    def apply_to(self, base: Mapping[str, Any]) -> dict[str, Any]:
        """Return the data of a configuration with the sections of this variant.

        Raises:
            ConfigError: Its file cannot be used.
        """
        data = dict(base)
        if self.file is not None:
            _use_file(data, self.file)
        for name in SECTIONS:
            section = getattr(self, name)
            if section is not None:
                before = {} if self.is_whole else section_of(data, name)
                set_section(data, name, merge_sections(before, section))
        return data

    def with_all_sections(self, checked: Mapping[str, Any]) -> VariantConfig:
        """Return the variant with its sections complete, as they are in checked data."""
        sections = {name: section_of(checked, name) for name in SECTIONS}
        return self.model_copy(update={"file": None, "is_whole": True, **sections})


def section_of(data: Mapping[str, Any], name: str) -> Any:
    """Return a section of a configuration's data that a variant may replace."""
    return data.get("sensors", {}).get(MOTION[1], {}) if name == "motion" else data.get(name, {})


def set_section(data: dict[str, Any], name: str, section: Any) -> None:
    """Replace a section; inverse: `section_of`."""
    if name == "motion":
        data["sensors"] = {**data.get("sensors", {}), "motion": section}
    else:
        data[name] = section


def merge_sections(before: Any, after: Any) -> Any:
    """Return one section changed by another, key by key.

    A draw, and a section of another kind, replace what was there.
    """
    both = isinstance(before, Mapping) and isinstance(after, Mapping)
    if not both or is_draw(before) or is_draw(after):
        return after
    if "kind" in after and after["kind"] != before.get("kind"):
        return after
    merged = dict(before)
    for key, value in after.items():
        merged[key] = merge_sections(before[key], value) if key in before else value
    return merged


def _use_file(data: dict[str, Any], file: Path) -> None:
    from oaisys_core.config.loading import load_config  # which imports this module

    found = load_config(file)
    for name in SECTIONS:
        set_section(data, name, section_of(found.model_dump(), name))
    unused = sorted(found.model_fields_set - {*WORLD, "generator_version"})
    if unused:
        _LOG.warning("%s: a variant does not use its %s", file, ", ".join(unused))
