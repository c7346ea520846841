"""Configuration of a timed drive: the vehicle, its way, and gravity."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from oaisys_core.config.section import (
    LEAST_RATE_HZ,
    ByKind,
    Metres,
    PlaceInDegrees,
    Position,
    Positive,
    Section,
)
from oaisys_core.files.path_fields import ConfigFile, ConfigPath

Waypoint = tuple[Metres, Metres] | Position


Gravity = Literal["earth", "moon", "mars"] | Annotated[float, Field(ge=0, le=100)]
"""A body, or its surface gravity in m/s^2."""

GRAVITY_M_S2 = {"earth": 9.80665, "moon": 1.624, "mars": 3.728}
"""Standard gravity of the Earth; GM / R^2 of the Moon and of Mars at their mean radius."""


class RoverConfig(Section):
    """A rover that drives through the waypoints on the true surface, its objects included.

    Its frame ``base_link`` lies between the wheels where they touch level ground, x forward. The
    plane that best fits the centres of its wheels gives its height and attitude. Each wheel is a
    rigid disc that rolls over the surface.

    Attributes:
        speed_m_s: Speed on level ground.
        acceleration_m_s2: Greatest acceleration along the way, and across it in curves.
        turn_rate_deg_s: Greatest rate at which its heading turns; it slows down in tight curves.
        max_tilt_deg: Steepest attitude; the way is refused, or ends, where it is steeper.
        slowest_share: Share of the speed that is left at the steepest attitude; in between, the
            speed falls in proportion to the tilt.
        axles_m: Place of each axle along x, wheels left and right.
        track_m: Distance between left and right wheels.
        wheel_radius_m: Radius of the wheels.
        clearance_m: Tallest object, and the greatest height of the surface above the plane of the
            wheels, that the rover can drive over, between its wheels or under them.
        suspension_m: Standard deviation of the Gaussian that smooths height and attitude along the
            way, as a suspension does; 0 for none.
        on_obstacle: Refuse a way that is blocked, or stop in front of the obstacle.
    """

    kind: Literal["rover"] = "rover"
    speed_m_s: float = Field(default=1.0, gt=0, le=100)
    acceleration_m_s2: float = Field(default=0.5, gt=0, le=100)
    turn_rate_deg_s: float = Field(default=45.0, gt=0, le=360)
    max_tilt_deg: float = Field(default=30.0, gt=0, lt=80)
    slowest_share: float = Field(default=0.3, gt=0, le=1)
    axles_m: tuple[float, ...] = Field(default=(0.85, 0.02, -0.80), min_length=2, max_length=8)
    track_m: float = Field(default=1.44, gt=0, le=20)
    wheel_radius_m: float = Field(default=0.25, gt=0, le=5)
    clearance_m: float = Field(default=0.3, gt=0, le=20)
    suspension_m: float = Field(default=0.15, ge=0, le=5)
    on_obstacle: Literal["refuse", "stop"] = "refuse"

    @model_validator(mode="after")
    def _stands(self) -> RoverConfig:
        if max(self.axles_m) - min(self.axles_m) < 0.01:
            raise ValueError("axles_m must be at least 0.01 m apart")
        return self


class DroneConfig(Section):
    """A drone that flies through the waypoints on a smooth curve, from rest to rest.

    Attributes:
        speed_m_s: Greatest speed.
        acceleration_m_s2: Greatest acceleration.
        hover_s: Seconds for which it stays at each waypoint; 0 to fly through those in between.
        height_above_ground_m: Height above the ground at each waypoint, which replaces z; null
            keeps z.
        heading: Along the way, or a fixed yaw in degrees.
        tilts: Whether it tilts with its acceleration, as a multicopter does; else it stays level.
    """

    kind: Literal["drone"]
    speed_m_s: float = Field(default=3.0, gt=0, le=1000)
    acceleration_m_s2: float = Field(default=2.0, gt=0, le=1000)
    hover_s: float = Field(default=0.0, ge=0, le=1e5)
    height_above_ground_m: float | None = None
    heading: Literal["way"] | float = "way"
    tilts: bool = True


class RecordedMotionConfig(Section):
    """The timed poses of a file, with a smooth motion between them.

    Attributes:
        path: CSV file with the columns t_s, x_m, y_m, z_m, qx, qy, qz, qw, EuRoC's ground truth
            (CSV), TUM file; or, with ``times_file``, KITTI's poses, COLMAP's ``images.txt`` or
            ``transforms.json``; relative to the configuration file.
        times_file: Text file with the seconds of each pose, one a line, such as KITTI's
            ``times.txt``; for files without times.
        camera: Camera whose optical frame the poses are of; null: the first camera for KITTI,
            COLMAP and ``transforms.json``, else the rig's base.
        topic: Topic of a bag; null: its only one with poses.
        frame: Frame whose transforms are the poses, of a topic of transforms; null: ``base_link``.
    """

    kind: Literal["file"]
    path: ConfigPath
    times_file: ConfigFile | None = None
    camera: str | None = None
    topic: str | None = None
    frame: str | None = None


AnyVehicle = Annotated[RoverConfig | DroneConfig | RecordedMotionConfig, ByKind()]


class OdometryDriftConfig(Section):
    """Errors of ``odometry`` that grow with the way; by default none. Ground truth has none.

    After a way of s metres, the errors of x, y, z and of the rotations about ``map``'s axes are
    normal and independent. Their standard deviations are those below times the square root of s, as
    those of random walks.

    Attributes:
        position_m_per_sqrt_m: Standard deviation of the position's error after 1 m, on each axis.
        rotation_deg_per_sqrt_m: The same of the orientation, about each axis.
        scale_error: Share by which distances from the start are too long, as with wheels that are
            smaller than assumed; negative: too short.
        seed: Seed of the errors, used together with that of the world.
    """

    position_m_per_sqrt_m: float = Field(default=0.0, ge=0, le=100)
    rotation_deg_per_sqrt_m: float = Field(default=0.0, ge=0, le=90)
    scale_error: float = Field(default=0.0, gt=-1, le=1)
    seed: int = Field(default=0, ge=0, lt=2**63)

    @property
    def active(self) -> bool:
        """Whether there is any error."""
        return any((self.position_m_per_sqrt_m, self.rotation_deg_per_sqrt_m, self.scale_error))


class DriveConfig(Section):
    """A timed drive, for ``oaisys drive``.

    Attributes:
        vehicle: What moves the rig.
        waypoints_m: (x, y) or (x, y, z) of the waypoints; a rover needs no z, a drone needs it
            unless ``height_above_ground_m`` is set.
        waypoints_lon_lat_deg: (longitude, latitude) or (longitude, latitude, elevation in m) of the
            waypoints, instead of ``waypoints_m``, on an elevation model that says where it lies;
            see ``oaisys place info``. East and north are positive.
        waypoints_file: CSV file with the columns x_m, y_m and perhaps z_m, or lon_deg, lat_deg and
            perhaps elevation_m, or any other file of
            poses, whose positions are the waypoints, instead of ``waypoints_m``; relative to the
            configuration file.
        waypoints_topic: Topic of a bag; null: its only one with poses.
        duration_s: Seconds after which the drive ends; null for the whole way.
        gravity: ``earth``, ``moon``, ``mars``, or a number in m/s^2; IMUs measure it, and a drone
            tilts against it.
        odometry_rate_hz: Rate of ground truth and odometry.
        odometry_drift: Errors of odometry.
    """

    vehicle: AnyVehicle = RoverConfig()
    waypoints_m: tuple[Waypoint, ...] = ()
    waypoints_lon_lat_deg: tuple[PlaceInDegrees, ...] = ()
    waypoints_file: ConfigPath | None = None
    waypoints_topic: str | None = None
    duration_s: Positive | None = None
    gravity: Gravity = "earth"
    odometry_rate_hz: float = Field(default=50.0, ge=LEAST_RATE_HZ, le=10_000)
    odometry_drift: OdometryDriftConfig = OdometryDriftConfig()

    @property
    def gravity_m_s2(self) -> float:
        """The surface gravity."""
        return GRAVITY_M_S2[self.gravity] if isinstance(self.gravity, str) else self.gravity

    @model_validator(mode="after")
    def _has_a_way(self) -> DriveConfig:
        given = (self.waypoints_m, self.waypoints_lon_lat_deg, self.waypoints_file)
        ways = sum(map(bool, given))
        if self.waypoints_topic is not None and self.waypoints_file is None:
            raise ValueError("waypoints_topic needs waypoints_file")
        if self.vehicle.kind == "file":
            if ways:
                raise ValueError("a vehicle of kind file follows its file: expected no waypoints")
            return self
        if ways != 1:
            raise ValueError(
                "expected one of waypoints_m, waypoints_lon_lat_deg and waypoints_file"
            )
        return self
