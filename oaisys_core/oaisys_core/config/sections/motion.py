"""How the rig moves where a sample's metadata gives no pose.

Every motion is a function of the batch's seed and the sample's id alone. Ranges are (least, most),
drawn evenly; angles are degrees, and act about the fixed axes of ``map`` in the order roll (x),
pitch (y), yaw (z).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from oaisys_core.config.paths import ConfigFile
from oaisys_core.config.section import (
    Positive,
    PositiveRange,
    Range,
    Section,
    Vector3,
    is_unit_quaternion,
)

MOST_ELEVATION_DEG = 89.9
"""Beyond it a rig that looks at a target would have no upright attitude."""


def _not_negative(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] < 0:
        raise ValueError("expected numbers of at least 0")
    return value


def _off_the_poles(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] < -MOST_ELEVATION_DEG or value[1] > MOST_ELEVATION_DEG:
        raise ValueError(f"expected angles between -{MOST_ELEVATION_DEG} and {MOST_ELEVATION_DEG}")
    return value


DistanceRange = Annotated[Range, AfterValidator(_not_negative)]
ElevationRange = Annotated[Range, AfterValidator(_off_the_poles)]
BoxRange = tuple[Range, Range, Range]
Quaternion = tuple[float, float, float, float]
Look = Literal["forward", "down"]
AtEnd = Literal["stay", "repeat", "refuse"]

STILL: Range = (0.0, 0.0)


class MotionConfig(Section):
    """What all motions share.

    Attributes:
        step_interval: Samples for which the rig stays where it is before it moves on.
        height_above_ground_m: Replaces a position's z by a height drawn from this range above the
            ground right below; None: z as it is.
        height_noise_m: Standard deviation of a height above the ground.
    """

    step_interval: int = Field(default=1, ge=1)
    height_above_ground_m: Range | None = None
    height_noise_m: float = Field(default=0.0, ge=0)


class AnglesConfig(Section):
    """A rig's attitude.

    Attributes:
        look: Where its x axis points before it is turned: along ``map``'s +x, or straight down
            with the image's upper edge towards +x.
        roll_deg, pitch_deg, yaw_deg: Turns about ``map``'s x, y and z axis, in this order.
    """

    look: Look = "forward"
    roll_deg: Range = STILL
    pitch_deg: Range = STILL
    yaw_deg: Range = STILL


class GivenMotion(Section):
    """The rig stays until metadata moves it."""

    kind: Literal["given"] = "given"


class CsvMotion(MotionConfig):
    """Poses from a file, one after the other.

    Attributes:
        path: CSV file as ``poses.csv`` is written; relative to the configuration file.
        columns: Names of the columns of a file without a header, such as sample_id, x_m, y_m, z_m,
            qw, qx, qy, qz; None: the first line names them.
        offset_m: Added to every position.
        at_end: What follows the last pose: it stays, the first one again, or an error.
    """

    kind: Literal["csv"]
    path: ConfigFile
    columns: tuple[str, ...] | None = None
    offset_m: Vector3 = (0.0, 0.0, 0.0)
    at_end: AtEnd = "refuse"

    @model_validator(mode="after")
    def _complete(self) -> CsvMotion:
        wanted = {"x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"}
        if self.columns is not None and not wanted <= set(self.columns):
            raise ValueError(f"columns must name {', '.join(sorted(wanted))}")
        return self


class RandomMotion(MotionConfig, AnglesConfig):
    """A position and angles drawn from ranges.

    Attributes:
        position_m: (least, most) of x, y and z.
    """

    kind: Literal["random"]
    position_m: BoxRange
    yaw_deg: Range = (-180.0, 180.0)


class HoverMotion(MotionConfig, AnglesConfig):
    """A random place at a distance over the stage; lifted where it would be too near to a surface.

    Attributes:
        x_m, y_m: Ranges of the place; None: the middle nine tenths of the stage.
    """

    kind: Literal["hover"]
    x_m: Range | None = None
    y_m: Range | None = None
    height_above_ground_m: DistanceRange = (3.0, 3.0)
    look: Look = "down"
    yaw_deg: Range = (-180.0, 180.0)


class TargetConfig(MotionConfig):
    """What all motions share that look at a target.

    Attributes:
        target_instance: Look at the object with this instance id, wherever it is by then.
        target_noise_m: Standard deviation, along each axis, of the point looked at.
        roll_deg: Turn about the viewing direction.
    """

    target_instance: int | None = Field(default=None, ge=1)
    target_noise_m: float = Field(default=0.0, ge=0)
    roll_deg: Range = STILL


class ApproachConfig(Section):
    """A straight way in towards the target.

    Attributes:
        distance_m: Distance at its end.
        steps: Steps of the rig from the first to the last.
    """

    distance_m: Positive
    steps: int = Field(default=30, ge=2)


class AroundTargetMotion(TargetConfig):
    """A random place on a shell around a target, looking at it.

    Attributes:
        target_m: Where it is, unless ``target_instance`` says.
        target_above_ground: Whether ``target_m``'s z counts from the ground there.
        distance_m: From the target.
        elevation_deg: Above the target's horizon.
        azimuth_deg: From +x counter-clockwise.
        redraw: Draw a place for each sample, or one for the whole batch.
        approach: Move in from there step by step; with ``redraw: batch`` only.
    """

    kind: Literal["around_target"]
    target_m: Vector3 = (0.0, 0.0, 0.0)
    target_above_ground: bool = False
    distance_m: PositiveRange = (5.0, 10.0)
    elevation_deg: ElevationRange = (20.0, 70.0)
    azimuth_deg: Range = (0.0, 360.0)
    redraw: Literal["sample", "batch"] = "sample"
    approach: ApproachConfig | None = None

    @model_validator(mode="after")
    def _one_way_in(self) -> AroundTargetMotion:
        if self.approach is not None and self.redraw != "batch":
            raise ValueError("an approach needs redraw: batch")
        return self


class LookAtMotion(TargetConfig):
    """A random position in ranges, looking at a point drawn from other ranges.

    Attributes:
        position_m: (least, most) of x, y and z of the rig.
        target_m: (least, most) of x, y and z of the target.
        target_is_offset: Whether the target is counted from the rig's drawn position.
        target_above_ground_m: Replaces the target's z by this height above the ground; None: as
            drawn.
    """

    kind: Literal["look_at"]
    position_m: BoxRange
    target_m: BoxRange = (STILL, STILL, STILL)
    target_is_offset: bool = False
    target_above_ground_m: float | None = None


class GridMotion(Section):
    """A survey that looks straight down, row by row and back again.

    Attributes:
        columns, rows: Views along x and y.
        altitude_m: Height above the ground right below each view.
        overlap: Share of an image's edge that neighbours share, on flat ground.
        centre_m: (x, y) of the grid's centre; None: the stage's.
        camera: Whose footprint settles the spacing; None: the first one's.
        step_interval: Samples for which the rig stays where it is before it moves on.
        at_end: What follows the last view: it stays, the first one again, or an error.
    """

    kind: Literal["grid"]
    columns: int = Field(default=6, ge=1, le=10_000)
    rows: int = Field(default=5, ge=1, le=10_000)
    altitude_m: Positive = 10.0
    overlap: float = Field(default=0.5, ge=0, lt=1)
    centre_m: tuple[float, float] | None = None
    camera: str | None = None
    step_interval: int = Field(default=1, ge=1)
    at_end: AtEnd = "repeat"


class SplineMotion(MotionConfig):
    """A smooth way through waypoints, at constant speed.

    Attributes:
        waypoints_m: (x, y, z) each; no two successive ones the same.
        quats_xyzw: Attitude at each waypoint; empty: by ``look``.
        look: Along the way, or straight down with the image's upper edge along it.
        step_m: Metres from one step to the next.
        is_closed: Whether it leads back to the first waypoint, and so on round.
        at_end: What follows the last point of a way that is not closed.
    """

    kind: Literal["spline"]
    waypoints_m: tuple[Vector3, ...] = Field(min_length=2)
    quats_xyzw: tuple[Quaternion, ...] = ()
    look: Look = "forward"
    step_m: Positive = 1.0
    is_closed: bool = False
    at_end: AtEnd = "stay"

    @model_validator(mode="after")
    def _consistent(self) -> SplineMotion:
        ring = [*self.waypoints_m, *(self.waypoints_m[:1] if self.is_closed else ())]
        if any(a == b for a, b in pairwise(ring)):
            raise ValueError("successive waypoints must differ")
        if self.quats_xyzw and len(self.quats_xyzw) != len(self.waypoints_m):
            raise ValueError("there must be one quaternion for each waypoint, or none")
        if not all(is_unit_quaternion(q) for q in self.quats_xyzw):
            raise ValueError("quats_xyzw must be unit quaternions")
        return self


AnyMotion = Annotated[
    GivenMotion
    | CsvMotion
    | RandomMotion
    | AroundTargetMotion
    | LookAtMotion
    | HoverMotion
    | GridMotion
    | SplineMotion,
    Field(discriminator="kind"),
]
