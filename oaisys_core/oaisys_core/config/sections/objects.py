"""Objects with a shape and a place: built in or from a file, standing or moving.

Lengths are metres, angles degrees (a person types them).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from oaisys_core.config.paths import ConfigFile
from oaisys_core.config.section import (
    Labelled,
    Metres,
    Position,
    Positive,
    Scale,
    Section,
    is_unit_quaternion,
)

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")]
Quaternion = tuple[float, float, float, float]
Fraction = Annotated[float, Field(ge=0, le=1)]


def unit_quaternion(value: Quaternion) -> Quaternion:
    """Return an (x, y, z, w) quaternion of norm 1 as it came."""
    if not is_unit_quaternion(value):
        raise ValueError("expected a unit quaternion")
    return value


class ShapedConfig(Labelled):
    """What something looks like: a built-in shape or a mesh from a file, one of the two.

    Attributes:
        shape: Built-in shape, see ``oaisys_core.scatter.shapes``.
        file: A .obj, .glb, .ply or .blend file; scripts in it never run.
        object_name: Name of the object in a file that has several; None: all of it.
        up_axis: Which of the file's axes points up; None: as its format has it.
        texture: Built-in texture set projected onto it; None: rocks wear ``rock_texture``, all
            else its own colours.
        tile_m: Edge length of one tile of the texture; None: ``rock_tile_m``.
        color_srgb: Plain colour in place of the shape's own and of any texture.
    """

    shape: str | None = None
    file: ConfigFile | None = None
    object_name: str | None = None
    up_axis: Literal["y", "z"] | None = None
    texture: str | None = None
    tile_m: Positive | None = None
    color_srgb: tuple[Fraction, Fraction, Fraction] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> ShapedConfig:
        if (self.shape is None) == (self.file is None):
            raise ValueError("expected either a shape or a file")
        return self


class PlacedObjectConfig(ShapedConfig):
    """Something that stands at a place of its own.

    Attributes:
        position_m, quat_xyzw: Pose of its base's centre in ``map``.
        on_ground: Whether the position's z counts from the ground below instead.
        scale: Factor on its own size, which is in metres; rocks and plants are 1 m large.
        hidden: Whether it is left out of the picture; it keeps its instance id.
    """

    position_m: Position
    quat_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    on_ground: bool = False
    scale: Scale = 1.0
    hidden: bool = False

    _unit = field_validator("quat_xyzw")(unit_quaternion)


class ObjectConfig(PlacedObjectConfig):
    """Something at a fixed place.

    Attributes:
        name: Key of its metadata, and of its shape's random stream.
    """

    name: Name


class TrajectoryConfig(Section):
    """Where something is at each sample: along waypoints, or as a CSV file says.

    Attributes:
        waypoints_m: (x, y) or (x, y, z) points in ``map``; z is 0 where it is not given.
        closed: Whether the way leads back to its beginning; else it ends at its last point.
        smooth: Whether the way is a spline through the points instead of straight lines.
        step_m: Way from one sample to the next.
        start_m: Way behind it when the batch begins.
        csv: Poses by row, in the columns of ``poses.csv``: the first is the batch's own, each
            sample takes the next; it ends at the last, or starts anew if ``closed``.
    """

    waypoints_m: tuple[tuple[Metres, Metres] | Position, ...] = ()
    closed: bool = False
    smooth: bool = False
    step_m: float = Field(default=0.5, ge=0)
    start_m: float = Field(default=0.0, ge=0)
    csv: ConfigFile | None = None

    @model_validator(mode="after")
    def _one_way(self) -> TrajectoryConfig:
        if self.csv is None and len(self.waypoints_m) < 2:
            raise ValueError("expected at least two waypoints_m, or a csv file")
        if self.csv is not None and self.waypoints_m:
            raise ValueError("expected either waypoints_m or a csv file, not both")
        points = [*self.waypoints_m, *(self.waypoints_m[:1] if self.closed else ())]
        if any(a == b for a, b in pairwise(points)):
            raise ValueError("two waypoints_m in a row are the same")
        return self


class MoverConfig(ShapedConfig):
    """Something that moves from sample to sample, its x axis forward.

    Attributes:
        name: Key of its metadata, and of its shape's random stream.
        trajectory: Where it is at each sample.
        on_ground: Whether its height and tilt follow the ground under it; else a waypoint's z and
            a CSV row's orientation hold.
        scale: Factor on its own size, which is in metres.
        hidden: Whether it is left out of the picture; it keeps its instance id.
    """

    name: Name
    trajectory: TrajectoryConfig
    on_ground: bool = True
    scale: Scale = 1.0
    hidden: bool = False
