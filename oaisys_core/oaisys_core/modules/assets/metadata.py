"""What a caller can set about the things on the ground, at a batch and at each sample."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator, model_validator

from oaisys_core.config.expectations import refusal
from oaisys_core.config.section import Position, Scale, Section
from oaisys_core.config.sections.objects import (
    Name,
    PlacedObjectConfig,
    Quaternion,
    unit_quaternion,
)
from oaisys_core.types import merged

PART = "asset"
Factor = Annotated[float, Field(ge=0, le=100)]
InstanceId = Annotated[str, Field(pattern=r"^[1-9][0-9]{0,9}$")]


class GroupEdit(Section):
    """A change to a whole group.

    Attributes:
        count_factor: Factor on the number of its things; at a batch only.
        scale: Factor on their sizes.
        hidden: Whether they are left out of the picture; None: as configured.
    """

    count_factor: Factor = 1.0
    scale: Scale = 1.0
    hidden: bool | None = None


class ObjectEdit(Section):
    """A change to one thing; what is None stays as it was drawn.

    Attributes:
        position_m, quat_xyzw: Its pose in ``map``; something that moves stays there then.
        scale: Factor on its size.
        hidden: Whether it is left out of the picture.
    """

    position_m: Position | None = None
    quat_xyzw: Quaternion | None = None
    scale: Scale = 1.0
    hidden: bool | None = None

    @field_validator("quat_xyzw")
    @classmethod
    def _unit(cls, value: Quaternion | None) -> Quaternion | None:
        return None if value is None else unit_quaternion(value)


class AddedConfig(PlacedObjectConfig):
    """Something that is added to a world.

    Attributes:
        prototype: Name of a group, object or mover whose mesh it has, in place of a shape or file.
    """

    prototype: Name | None = None

    @model_validator(mode="after")
    def _one_source(self) -> AddedConfig:
        if sum(source is not None for source in (self.shape, self.file, self.prototype)) != 1:
            raise ValueError("expected one of shape, file and prototype")
        return self


class AssetMetadata(Section):
    """All changes since a batch began; an entry that is null again changes nothing.

    Attributes:
        count_factor: Factor on the number of rocks and things of every group; at a batch only.
        groups: Changes by the group's name.
        objects: Changes by instance id.
        add: What is added, by a name of its own that gives it its instance id.
    """

    count_factor: Factor = 1.0
    groups: dict[Name, GroupEdit | None] = Field(default_factory=dict)
    objects: dict[InstanceId, ObjectEdit | None] = Field(default_factory=dict)
    add: dict[Name, AddedConfig | None] = Field(default_factory=dict)

    def group(self, name: str) -> GroupEdit:
        """Return the change to a group."""
        return self.groups.get(name) or GroupEdit()

    @property
    def object_edits(self) -> dict[int, ObjectEdit]:
        """Changes by instance id as a number."""
        return {int(key): edit for key, edit in self.objects.items() if edit is not None}

    @property
    def added(self) -> dict[str, AddedConfig]:
        """What is there, by name, in the order of names."""
        return {name: spec for name, spec in sorted(self.add.items()) if spec is not None}


def asset_metadata(earlier: Mapping[str, Any], metadata: Mapping[str, Any] | None) -> AssetMetadata:
    """Return what holds after ``metadata`` was applied on top of ``earlier``.

    Raises:
        InvalidInputError: A key is unknown or a value does not fit.
    """
    data = merged(earlier, metadata)
    try:
        return AssetMetadata.model_validate(data)
    except ValidationError as error:
        raise refusal(error, data, "metadata", PART) from error
