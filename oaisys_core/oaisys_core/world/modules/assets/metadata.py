"""Metadata of assets: what a caller can change about objects, per batch and per sample."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from oaisys_core.config.expectations import refusal
from oaisys_core.config.section import Position, Quaternion, Scale, Section
from oaisys_core.config.sections.objects import (
    Name,
    PlacedObjectConfig,
)
from oaisys_core.types import merge

PART = "asset"
Factor = Annotated[float, Field(ge=0, le=100)]
InstanceId = Annotated[str, Field(pattern=r"^[1-9][0-9]{0,9}$")]


class GroupEdit(Section):
    """An edit of a whole group.

    Attributes:
        count_factor: Factor on its number of instances; for a batch only.
        scale: Factor on the sizes.
        hidden: Whether the group is hidden; None keeps the configured value.
    """

    count_factor: Factor = 1.0
    scale: Scale = 1.0
    hidden: bool | None = None


class ObjectEdit(Section):
    """An edit of one instance; fields that are None keep the drawn value.

    Attributes:
        position_m, quat_xyzw: Pose in ``map``; a mover then stays at this pose.
        scale: Factor on the size.
        hidden: Whether it is hidden.
    """

    position_m: Position | None = None
    quat_xyzw: Quaternion | None = None
    scale: Scale = 1.0
    hidden: bool | None = None


class AddedConfig(PlacedObjectConfig):
    """An object that is added to the world.

    Attributes:
        prototype: Name of a group, object or mover whose mesh it uses, instead of a shape or file.
    """

    prototype: Name | None = None

    @model_validator(mode="after")
    def _one_source(self) -> AddedConfig:
        if sum(source is not None for source in (self.shape, self.file, self.prototype)) != 1:
            raise ValueError("expected one of shape, file and prototype")
        return self


class AssetMetadata(Section):
    """All edits since the batch began; entries that were set back to null have no effect.

    Attributes:
        count_factor: Factor on the number of rocks and of instances of all groups; batch only.
        groups: Edits by group name.
        objects: Edits by instance id.
        add: Added objects by a unique name, which determines the instance id.
        time_s: Simulated time, at which movers are that have a speed; None moves them by samples.
    """

    count_factor: Factor = 1.0
    groups: dict[Name, GroupEdit | None] = Field(default_factory=dict)
    objects: dict[InstanceId, ObjectEdit | None] = Field(default_factory=dict)
    add: dict[Name, AddedConfig | None] = Field(default_factory=dict)
    time_s: float | None = Field(default=None, ge=0, le=1e9)

    def group(self, name: str) -> GroupEdit:
        """Return the edit of a group."""
        return self.groups.get(name) or GroupEdit()

    @property
    def object_edits(self) -> dict[int, ObjectEdit]:
        """Edits by instance id as a number."""
        return {int(key): edit for key, edit in self.objects.items() if edit is not None}

    @property
    def additions(self) -> dict[str, AddedConfig]:
        """The added objects, sorted by name."""
        return {name: spec for name, spec in sorted(self.add.items()) if spec is not None}


def asset_metadata(earlier: Mapping[str, Any], metadata: Mapping[str, Any] | None) -> AssetMetadata:
    """Return the edits after ``metadata`` was merged into ``earlier``.

    Raises:
        InvalidInputError: A key is unknown or a value is invalid.
    """
    data = merge(earlier, metadata)
    try:
        return AssetMetadata.model_validate(data)
    except ValidationError as error:
        raise refusal(error, data, AssetMetadata, "metadata", PART) from error
