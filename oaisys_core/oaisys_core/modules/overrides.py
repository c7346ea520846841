"""Metadata that overrides fields of a configuration section, under the section's own checks."""

from __future__ import annotations

from typing import TypeVar

from pydantic import ValidationError

from oaisys_core.config.section import Section
from oaisys_core.errors import InvalidInputError
from oaisys_core.module import Metadata

SectionT = TypeVar("SectionT", bound=Section)


def overridden(section: SectionT, metadata: Metadata, part: str) -> SectionT:
    """Return ``section`` with the fields in ``metadata`` replaced.

    Raises:
        InvalidInputError: A key is unknown or a value does not fit; its path starts with
            ``metadata.{part}``.
    """
    if not metadata:
        return section
    try:
        return type(section).model_validate({**section.model_dump(), **metadata})
    except ValidationError as error:
        detail = error.errors()[0]
        path = ".".join(("metadata", part, *(str(key) for key in detail["loc"])))
        known = ", ".join(sorted(type(section).model_fields))
        unknown = detail["type"] == "extra_forbidden"
        expected = f"one of the keys {known}" if unknown else detail["msg"]
        raise InvalidInputError(path, detail["input"], expected) from error
