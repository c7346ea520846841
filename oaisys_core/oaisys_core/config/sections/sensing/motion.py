"""Configuration of the rig's motion, which applies if a sample's metadata gives no pose.

A motion depends only on the batch's seed and the sample's id. Ranges are (least, most) of a uniform
distribution. Angles are in degrees, about the fixed axes of ``map`` in the order roll (x), pitch
(y), yaw (z).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from oaisys_core.config.section import (
    ByKind,
    Latitude,
    Longitude,
    Metres,
    PlaceInDegrees,
    Position,
    Positive,
    PositiveRange,
    Quaternion,
    Range,
    Section,
)
from oaisys_core.files.path_fields import ConfigPath

MAX_ELEVATION_DEG = 89.9
"""Limit up to which a rig that looks at a target has a defined upright orientation."""


def _not_negative(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] < 0:
        raise ValueError("expected numbers of at least 0")
    return value


def _off_the_poles(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] < -MAX_ELEVATION_DEG or value[1] > MAX_ELEVATION_DEG:
        raise ValueError(f"expected angles between -{MAX_ELEVATION_DEG} and {MAX_ELEVATION_DEG}")
    return value


DistanceRange = Annotated[Range, AfterValidator(_not_negative)]
ElevationRange = Annotated[Range, AfterValidator(_off_the_poles)]
BoxRange = tuple[Range, Range, Range]
Look = Literal["forward", "down"]
AtEnd = Literal["stay", "repeat", "refuse"]

STILL: Range = (0.0, 0.0)


class MotionConfig(Section):
    """Keys that several motions share.

    Attributes:
        step_interval: Number of samples for which the rig keeps each pose.
        height_above_ground_m: Range of heights above the ground, which replace z; None keeps z.
        height_noise_m: Standard deviation of the height above the ground.
    """

    step_interval: int = Field(default=1, ge=1)
    height_above_ground_m: Range | None = None
    height_noise_m: float = Field(default=0.0, ge=0)


class AnglesConfig(Section):
    """The orientation of a rig.

    Attributes:
        look: Direction of the x axis before the rotation: along ``map``'s +x, or straight down with
            the image's upper edge towards +x.
        roll_deg, pitch_deg, yaw_deg: Rotations about ``map``'s x, y and z axes, in this order.
    """

    look: Look = "forward"
    roll_deg: Range = STILL
    pitch_deg: Range = STILL
    yaw_deg: Range = STILL


class GivenMotion(Section):
    """No motion: only metadata moves the rig."""

    kind: Literal["given"] = "given"


class CsvMotion(MotionConfig):
    """The poses of a file, one after the other.

    Attributes:
        path: File of poses, relative to the configuration file: CSV as ``poses.csv``, TUM, EuRoC,
            KITTI, COLMAP's ``images.txt``, ``transforms.json``; or an MCAP bag.
        columns: Names of the columns of a file without a header, such as sample_id, x_m, y_m, z_m,
            qw, qx, qy, qz; None if the first line is a header.
        camera: Camera whose optical frame the poses are of; None: the first camera for KITTI,
            COLMAP and ``transforms.json``, else the rig's base.
        topic: Topic of a bag; None: its only one with poses.
        frame: Frame whose transforms are the poses, of a topic of transforms; None: ``base_link``.
        offset_m: Offset added to every position.
        at_end: After the last pose: keep it, start again, or fail.
    """

    kind: Literal["csv"]
    path: ConfigPath
    columns: tuple[str, ...] | None = None
    camera: str | None = None
    topic: str | None = None
    frame: str | None = None
    offset_m: Position = (0.0, 0.0, 0.0)
    at_end: AtEnd = "refuse"

    @model_validator(mode="after")
    def _complete(self) -> CsvMotion:
        wanted = {"x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"}
        if self.columns is not None and not wanted <= set(self.columns):
            raise ValueError(f"columns must name {', '.join(sorted(wanted))}")
        return self


class RandomMotion(MotionConfig, AnglesConfig):
    """Random positions and angles.

    Attributes:
        position_m: Ranges of x, y and z.
    """

    kind: Literal["random"]
    position_m: BoxRange
    yaw_deg: Range = (-180.0, 180.0)


class HoverMotion(MotionConfig, AnglesConfig):
    """Random positions above the stage, lifted if they are too close to a surface.

    Attributes:
        x_m, y_m: Ranges of the position; None for the middle nine tenths of the stage.
    """

    kind: Literal["hover"]
    x_m: Range | None = None
    y_m: Range | None = None
    height_above_ground_m: DistanceRange = (3.0, 3.0)
    look: Look = "down"
    yaw_deg: Range = (-180.0, 180.0)


class TargetConfig(MotionConfig):
    """Keys of the motions that look at a target.

    Attributes:
        target_instance: Instance id of an object to look at, at its current position.
        target_noise_m: Standard deviation of the target point along each axis.
        roll_deg: Rotation about the viewing direction.
    """

    target_instance: int | None = Field(default=None, ge=1)
    target_noise_m: float = Field(default=0.0, ge=0)
    roll_deg: Range = STILL


class ApproachConfig(Section):
    """A straight approach to the target.

    Attributes:
        distance_m: Distance from the target at the end.
        steps: Number of steps.
    """

    distance_m: Positive
    steps: int = Field(default=30, ge=2)


class AroundTargetMotion(TargetConfig):
    """Random positions around a target, looking at it.

    Attributes:
        target_m: Position of the target, unless ``target_instance`` is given.
        target_lon_lat_deg: (longitude, latitude) or (longitude, latitude, elevation in m) of the
            target, instead of ``target_m``, on an elevation model that says where it lies. Without
            an elevation, and with ``target_above_ground``, z is that of ``target_m``.
        target_above_ground: Whether the z of ``target_m`` is relative to the ground.
        distance_m: Distance from the target.
        elevation_deg: Elevation above the horizon of the target.
        azimuth_deg: Azimuth counter-clockwise from +x.
        redraw: Draw a position for each sample, or one for the whole batch.
        approach: Move towards the target step by step; only with ``redraw: batch``.
    """

    kind: Literal["around_target"]
    target_m: Position = (0.0, 0.0, 0.0)
    target_lon_lat_deg: PlaceInDegrees | None = None
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
    """Random positions, looking at random targets.

    Attributes:
        position_m: Ranges of the rig's x, y and z.
        target_m: Ranges of the target's x, y and z.
        target_is_offset: Whether the target is relative to the rig's drawn position.
        target_above_ground_m: Height above the ground that replaces the target's z; None keeps z.
    """

    kind: Literal["look_at"]
    position_m: BoxRange
    target_m: BoxRange = (STILL, STILL, STILL)
    target_is_offset: bool = False
    target_above_ground_m: float | None = None


class GridMotion(Section):
    """A survey that looks straight down, row by row in alternating directions.

    Attributes:
        columns, rows: Number of views along x and y.
        altitude_m: Height above the ground below each view.
        overlap: Share of an image's edge that neighbouring views have in common, on flat ground.
        centre_m: (x, y) of the grid's centre; None for that of the stage.
        centre_lon_lat_deg: Longitude and latitude of the centre instead, on an elevation model that
            says where it lies.
        camera: Camera whose footprint determines the spacing; None for the first camera.
        step_interval: Number of samples for which the rig keeps each pose.
        at_end: After the last view: keep it, start again, or fail.
    """

    kind: Literal["grid"]
    columns: int = Field(default=6, ge=1, le=10_000)
    rows: int = Field(default=5, ge=1, le=10_000)
    altitude_m: Positive = 10.0
    overlap: float = Field(default=0.5, ge=0, lt=1)
    centre_m: tuple[Metres, Metres] | None = None
    centre_lon_lat_deg: tuple[Longitude, Latitude] | None = None
    camera: str | None = None
    step_interval: int = Field(default=1, ge=1)
    at_end: AtEnd = "repeat"

    @model_validator(mode="after")
    def _one_centre(self) -> GridMotion:
        if self.centre_m is not None and self.centre_lon_lat_deg is not None:
            raise ValueError("expected either centre_m or centre_lon_lat_deg, not both")
        return self


class SplineMotion(MotionConfig):
    """A smooth path through waypoints, at constant speed.

    Attributes:
        waypoints_m: (x, y, z) of each waypoint; successive ones must differ.
        waypoints_lon_lat_deg: (longitude, latitude, elevation in m) of the waypoints instead of
            ``waypoints_m``, on an elevation model that says where it lies. They need no elevation
            with ``height_above_ground_m``.
        quats_xyzw: Orientation at each waypoint; empty to use ``look``.
        look: Along the path, or straight down with the image's upper edge along the path.
        step_m: Distance between steps.
        is_closed: Whether the path returns to the first waypoint and repeats.
        at_end: After the last point of an open path: keep it, start again, or fail.
    """

    kind: Literal["spline"]
    waypoints_m: tuple[Position, ...] = ()
    waypoints_lon_lat_deg: tuple[PlaceInDegrees, ...] = ()
    quats_xyzw: tuple[Quaternion, ...] = ()
    look: Look = "forward"
    step_m: Positive = 1.0
    is_closed: bool = False
    at_end: AtEnd = "stay"

    @model_validator(mode="after")
    def _consistent(self) -> SplineMotion:
        if bool(self.waypoints_m) == bool(self.waypoints_lon_lat_deg):
            raise ValueError("expected one of waypoints_m and waypoints_lon_lat_deg")
        points = self.waypoints_m or self.waypoints_lon_lat_deg
        if len(points) < 2:
            raise ValueError("expected at least two waypoints")
        is_flat = any(len(point) == 2 for point in points)
        if is_flat and self.height_above_ground_m is None:
            raise ValueError("waypoints without an elevation need height_above_ground_m")
        if any(a == b for a, b in pairwise([*points, *(points[:1] if self.is_closed else ())])):
            raise ValueError("successive waypoints must differ")
        if self.quats_xyzw and len(self.quats_xyzw) != len(points):
            raise ValueError("there must be one quaternion for each waypoint, or none")
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
    ByKind(),
]
