"""Trajectories, and what a drive along one brings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from oaisys_core.types.poses import Odometry, Pose, TimedPoses
from oaisys_core.types.samples import Sample

ODOMETRY = "odometry"
"""Name under which a drive counts odometry among its sensors."""


@dataclass(frozen=True)
class ImuReading:
    """One measurement of one IMU, in its own frame.

    Attributes:
        sensor: Name of the IMU.
        angular_rate_rad_s: Angular rate about x, y and z.
        specific_force_m_s2: Acceleration minus gravity.
    """

    sensor: str
    angular_rate_rad_s: tuple[float, float, float]
    specific_force_m_s2: tuple[float, float, float]


@dataclass(frozen=True)
class DriveInstant:
    """Everything that a drive brings at one simulated time.

    Attributes:
        time_ns: Simulated time.
        pose: True pose of ``base_link`` in ``map``.
        velocity_m_s, angular_rate_rad_s: True twist in ``base_link``, as in ``nav_msgs/Odometry``.
        has_odometry: Whether odometry is due.
        odometry: What it estimates at this time, due or not; None without drift.
        imus: What the IMUs measure that are due.
        sensors: Names of the cameras and lidars that are due.
        sample: What these saw; None where none is due.
    """

    time_ns: int
    pose: Pose
    velocity_m_s: tuple[float, float, float]
    angular_rate_rad_s: tuple[float, float, float]
    has_odometry: bool = False
    odometry: Odometry | None = None
    imus: tuple[ImuReading, ...] = ()
    sensors: tuple[str, ...] = ()
    sample: Sample | None = None


@dataclass(frozen=True)
class PlannedTrajectory:
    """A trajectory that a simulator has planned and keeps for drives.

    Attributes:
        name: Its name in the simulator.
        poses: The poses that its motion interpolates; simulated time starts at the first one.
        end_s: Time at which a drive ends.
        length_m: Length of the way until then.
        gravity_m_s2: Gravity that IMUs measure.
        odometry_rate_hz: Rate of odometry.
        obstacle: What a rover stops in front of, in words; empty for nothing.
        odometry_drift_json: Errors of odometry, with the configuration's keys; empty for none.
    """

    name: str
    poses: TimedPoses
    end_s: float
    length_m: float
    gravity_m_s2: float
    odometry_rate_hz: float
    obstacle: str = ""
    odometry_drift_json: str = ""


@dataclass(frozen=True)
class DriveOutline:
    """A drive before its first measurement.

    Attributes:
        trajectory: Name of the trajectory.
        batch_id: The world.
        start_ns, end_ns: Simulated time at the beginning and at the end.
        due: The number of measurements of each sensor, and of `ODOMETRY`.
    """

    trajectory: str
    batch_id: int
    start_ns: int
    end_ns: int
    due: Mapping[str, int]
