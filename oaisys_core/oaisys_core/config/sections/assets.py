"""Configuration of the objects on the ground.

Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from oaisys_core.config.section import (
    MIN_SIZE_M,
    Labelled,
    LabelText,
    OneForBoth,
    Position,
    Positive,
    Quaternion,
    Section,
    SemanticId,
    TileEdge,
    Vector3,
)
from oaisys_core.config.sections.groups import CountRange, FractionRange, GroupConfig
from oaisys_core.config.sections.objects import MoverConfig, ObjectConfig
from oaisys_core.geometry import MAX_M

MAX_GROUPS, MAX_OBJECTS = 1000, 2500
"""Largest numbers, so that each has its own instance ids."""


Cover = Annotated[float, Field(gt=0, le=0.5)]


class RockGroupConfig(Labelled):
    """Randomly scattered rocks of one kind.

    Rounded rocks and pebbles prefer places where water runs, others lie near steep ground.

    Attributes:
        kind: Shape, see ``oaisys_core.procedural.scatter.rocks``.
        count: (least, most) number of rocks.
        cover: (least, most) share of the ground that rocks of all sizes cover, above 0 and at most
            0.5. Number and sizes then follow the law of landing sites on Mars (Golombek and Rapp
            1997) instead of ``count`` and ``size_exponent``.
        size_m: (smallest, largest) size along the longest axis.
        size_exponent: Exponent of the power law of sizes: the number above size D goes as
            D**-exponent.
        variants: Number of different meshes.
        sink: (least, most) share of a rock's height below the ground; half of the rocks are in the
            lowest eighth of the range.
        max_slope_deg: Steepest ground on which rocks are placed.
        beyond_stage: Whether rocks also lie on the land around the stage, fewer with the distance.
    """

    kind: str = "angular"
    count: CountRange = (120, 120)
    cover: Annotated[tuple[Cover, Cover], OneForBoth()] | None = None
    size_m: Annotated[tuple[float, float], OneForBoth()] = (0.15, 1.2)
    size_exponent: Positive = 1.8
    variants: int = Field(default=24, ge=1, le=64)
    sink: FractionRange = (0.1, 0.6)
    max_slope_deg: float = Field(default=40.0, ge=0, le=90)
    beyond_stage: bool = True
    label: LabelText = "rock"
    semantic_id: SemanticId = 10

    @field_validator("count", "cover", "size_m", "sink")
    @classmethod
    def _check_order(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and (value[0] < 0 or value[0] > value[1]):
            raise ValueError("expected [least, most], the least at least 0")
        return value

    @field_validator("size_m")
    @classmethod
    def _positive(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] < MIN_SIZE_M or value[1] > MAX_M:
            raise ValueError(f"expected sizes from {MIN_SIZE_M:g} to {MAX_M:g} m")
        return value


def _radius_too(schema: dict[str, Any]) -> None:
    """Add to the schema that a sphere may be given by its radius."""
    schema["properties"]["radius_m"] = {"exclusiveMinimum": 0, "type": "number"} | {
        "description": "Radius of a sphere, instead of `size_m`."
    }
    schema["required"].remove("size_m")
    schema["anyOf"] = [{"required": ["size_m"]}, {"required": ["radius_m"]}]


class PrimitiveConfig(Labelled):
    """An exact sphere or box, for calibration.

    Attributes:
        shape: Kind of primitive.
        size_m: Edge lengths of a box; for a sphere three times its radius, or use ``radius_m``.
        position_m, quat_xyzw: Pose of the centre in ``map``.
        color_srgb: Uniform colour.
    """

    model_config = ConfigDict(json_schema_extra=_radius_too)

    shape: Literal["sphere", "box"]
    size_m: Position
    position_m: Position
    quat_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    label: LabelText = "target"
    semantic_id: SemanticId = 20
    color_srgb: Vector3 = (0.6, 0.3, 0.2)

    @model_validator(mode="before")
    @classmethod
    def _radius_alone(cls, data: object) -> object:
        """Accept ``radius_m`` instead of ``size_m``."""
        if isinstance(data, dict) and "radius_m" in data and "size_m" not in data:
            radius_m = data["radius_m"]
            rest = {key: value for key, value in data.items() if key != "radius_m"}
            return {**rest, "size_m": (radius_m, radius_m, radius_m)}
        return data

    @model_validator(mode="after")
    def _solid(self) -> PrimitiveConfig:
        if min(self.size_m) <= 0:
            raise ValueError("size_m must be above 0")
        if self.shape == "sphere" and len(set(self.size_m)) != 1:
            raise ValueError("a sphere has one radius")
        return self


class AssetsConfig(Section):
    """Objects on the ground.

    Attributes:
        rocks: Scattered rocks, all drawn from one random stream.
        primitives: Exact spheres and boxes.
        groups: Scattered objects of any shape; each group has its own random stream.
        objects: Objects at fixed positions.
        movers: Objects that move from sample to sample.
        rock_texture: Built-in texture set of the rocks; by default rock, and basalt on the Moon and
            Mars (``stage.body``).
        rock_tile_m: Edge length of a tile of this texture.
    """

    rocks: tuple[RockGroupConfig, ...] = (
        RockGroupConfig(kind="angular", count=(650, 650), size_m=(0.15, 1.2)),
        RockGroupConfig(kind="rounded", count=(400, 400), size_m=(0.15, 0.9)),
        RockGroupConfig(kind="slab", count=(160, 160), size_m=(0.3, 1.4)),
        RockGroupConfig(kind="boulder", count=(60, 60), size_m=(0.8, 2.4)),
    )
    primitives: tuple[PrimitiveConfig, ...] = ()
    groups: tuple[GroupConfig, ...] = Field(default=(), max_length=MAX_GROUPS)
    objects: tuple[ObjectConfig, ...] = Field(default=(), max_length=MAX_OBJECTS)
    movers: tuple[MoverConfig, ...] = Field(default=(), max_length=MAX_OBJECTS)
    rock_texture: str = "rock"
    rock_tile_m: TileEdge = 1.6

    @model_validator(mode="after")
    def _names_differ(self) -> AssetsConfig:
        for part in (self.groups, self.objects, self.movers):
            names = [thing.name for thing in part]
            twice = {name for name in names if names.count(name) > 1}
            if twice:
                raise ValueError(f"several of a kind have the name {', '.join(sorted(twice))}")
        return self

    @property
    def items_with_labels(self) -> tuple[Labelled, ...]:
        """Everything in the section that has labels."""
        return (*self.rocks, *self.primitives, *self.groups, *self.objects, *self.movers)
