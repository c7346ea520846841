"""From the configuration's section ``drive`` to a trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from oaisys_core.config.expectations import refusal
from oaisys_core.config.sections.drive import (
    DriveConfig,
    DroneConfig,
    OdometryDriftConfig,
    RecordedMotionConfig,
    RoverConfig,
)
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.csv_tables import read_numbered_csv
from oaisys_core.files.poses import (
    PoseSelection,
    is_named_columns_file,
    of_rig,
    read_pose_table,
)
from oaisys_core.files.poses.records import MAX_POSES, number
from oaisys_core.geometry import check_position, places
from oaisys_core.raycast.clearance import HeightLookup
from oaisys_core.trajectory.drone import plan_flight
from oaisys_core.trajectory.files import read_trajectory
from oaisys_core.trajectory.rover import Obstacle, plan_rover_drive
from oaisys_core.trajectory.trajectory import Trajectory
from oaisys_core.types import FloatArray, Georeference, SensorInfo

LATEST_S = 2.0**31 - 1
"""Last time of a drive: stamps have 31 bits for whole seconds, and no sign."""


@dataclass(frozen=True)
class DrivePlan:
    """A planned drive.

    Attributes:
        trajectory: The motion of ``base_link``.
        end_s: Time at which the drive ends, on or before the trajectory's end.
        gravity_m_s2: Gravity that IMUs measure.
        odometry_rate_hz: Rate of ground truth and odometry.
        odometry_drift: Errors of odometry.
        obstacle: What a rover stops in front of; None for no obstacle.
    """

    trajectory: Trajectory
    end_s: float
    gravity_m_s2: float
    odometry_rate_hz: float
    odometry_drift: OdometryDriftConfig
    obstacle: Obstacle | None = None

    def length_m(self) -> float:
        """Return the length of the way that is driven."""
        times_s = np.linspace(self.trajectory.start_s, self.end_s, 10_001)
        steps_m = np.diff(self.trajectory.position_m(times_s), axis=0)
        return float(np.linalg.norm(steps_m, axis=1).sum())


def plan_drive(
    config: DriveConfig,
    heights: HeightLookup,
    sensors: Sequence[SensorInfo] = (),
    georeference: Georeference | None = None,
) -> DrivePlan:
    """Return the drive that a configuration describes.

    Args:
        config: Vehicle and waypoints.
        heights: Looks up ground and topmost surface below (N, 3) points in ``map``.
        sensors: The rig's cameras, for files with the poses of one.
        georeference: Where the ground lies on its body, for waypoints in degrees.

    Raises:
        InvalidInputError: A file cannot be read, the ground is of no place, or the vehicle cannot
            drive this way.
    """
    obstacle = None
    vehicle = config.vehicle
    if isinstance(vehicle, RecordedMotionConfig):
        selection = PoseSelection(topic=vehicle.topic, frame=vehicle.frame)
        trajectory = read_trajectory(
            vehicle.path, selection, sensors, vehicle.camera, vehicle.times_file
        )
    elif isinstance(vehicle, RoverConfig):
        plan = plan_rover_drive(
            vehicle, _waypoints_m(config, sensors, georeference)[:, :2], heights
        )
        trajectory, obstacle = plan.trajectory, plan.obstacle
    else:
        waypoints_m = _in_the_air(vehicle, _waypoints_m(config, sensors, georeference), heights)
        trajectory = plan_flight(vehicle, waypoints_m, config.gravity_m_s2)
    return plan_along(trajectory, config, obstacle)


def plan_along(
    trajectory: Trajectory, config: DriveConfig, obstacle: Obstacle | None = None
) -> DrivePlan:
    """Return the drive along a trajectory; duration, gravity and odometry are as configured.

    Raises:
        InvalidInputError: It begins before 0 s or ends after `LATEST_S`.
    """
    for index, time_s in ((0, trajectory.start_s), (-1, trajectory.end_s)):
        if not 0 <= time_s <= LATEST_S:
            number = index % len(trajectory.times_s)
            expected = f"a time from 0 s to {LATEST_S:g} s, as stamps have"
            raise InvalidInputError(f"trajectory.times_s.{number}", time_s, expected)
    end_s = trajectory.end_s
    if config.duration_s is not None:
        end_s = min(end_s, trajectory.start_s + config.duration_s)
    return DrivePlan(
        trajectory=trajectory,
        end_s=end_s,
        gravity_m_s2=config.gravity_m_s2,
        odometry_rate_hz=config.odometry_rate_hz,
        odometry_drift=config.odometry_drift,
        obstacle=obstacle,
    )


WAY_KEYS = ("waypoints_m", "waypoints_lon_lat_deg", "waypoints_file", "waypoints_topic")
"""Keys of a drive that say where it leads; a new one replaces all of them, and the duration."""


def change_drive(configured: DriveConfig | None, changes: Mapping[str, Any]) -> DriveConfig:
    """Return the configured drive with some keys replaced, as a request gives them.

    Raises:
        InvalidInputError: A key is unknown, a value is invalid, or there is no way to drive.
    """
    before = {} if configured is None else configured.model_dump(mode="json", exclude_unset=True)
    vehicle = changes.get("vehicle")
    follows_file = isinstance(vehicle, Mapping) and vehicle.get("kind") == "file"
    if follows_file or any(key in changes for key in WAY_KEYS):
        before = {k: v for k, v in before.items() if k not in (*WAY_KEYS, "duration_s")}
    data = {**before, **changes}
    try:
        return DriveConfig.model_validate(data)
    except ValidationError as error:
        raise refusal(error, data, DriveConfig, "drive") from error


def _waypoints_m(
    config: DriveConfig, sensors: Sequence[SensorInfo], georeference: Georeference | None
) -> FloatArray:
    """Return (K, 3) waypoints; z is NaN where none is given."""
    if config.waypoints_lon_lat_deg:
        return places.waypoints_in_map(
            georeference, config.waypoints_lon_lat_deg, "drive.waypoints_lon_lat_deg"
        )
    if config.waypoints_file is not None:
        selection = PoseSelection(topic=config.waypoints_topic)
        return read_waypoints(config.waypoints_file, selection, sensors, georeference)
    return np.array([(*point, np.nan)[:3] for point in config.waypoints_m])


def read_waypoints(
    path: Path,
    selection: PoseSelection | None = None,
    sensors: Sequence[SensorInfo] = (),
    georeference: Georeference | None = None,
) -> FloatArray:
    """Return the (K, 3) waypoints of a CSV file with the columns x_m, y_m and perhaps z_m.

    The columns may be lon_deg, lat_deg and perhaps elevation_m instead. Without z_m or elevation_m,
    z is NaN. Of any other file that `read_pose_table` knows, they are the positions
    of the rig's base; of poses that follow each other at one place, the first counts.

    Args:
        path: The file.
        selection, sensors: See `read_pose_table` and `of_rig`.
        georeference: Of the ground, for degrees.

    Raises:
        InvalidInputError: The file cannot be read, or a row has no numbers; names line and value.
    """
    if is_named_columns_file(path):
        return _named_waypoints(path, georeference)
    positions_m = of_rig(read_pose_table(path, selection), sensors).positions_m
    moves = np.append(True, (np.diff(positions_m, axis=0) != 0).any(axis=1))
    return np.asarray(positions_m[moves])


IN_METRES, IN_DEGREES = ("x_m", "y_m", "z_m"), ("lon_deg", "lat_deg", "elevation_m")
"""Columns of a file of waypoints; the third may be missing."""


def _named_waypoints(path: Path, georeference: Georeference | None) -> FloatArray:
    try:
        rows = read_numbered_csv(path, MAX_POSES)
    except (OSError, ValueError) as error:
        expected = f"a readable CSV file ({error})"
        raise InvalidInputError("drive.waypoints_file", str(path), expected) from error
    if not rows:
        raise InvalidInputError("drive.waypoints_file", str(path), "rows below the header")
    columns = IN_DEGREES if IN_DEGREES[0] in rows[0][1] else IN_METRES
    points = [_named_point(row, columns, f"{path}:{line}", f"{path}:1") for line, row in rows]
    if columns is IN_METRES:
        return np.array(points)
    return places.waypoints_in_map(georeference, points, f"drive.waypoints_file {path}")


def _named_point(
    row: Mapping[str, str], columns: Sequence[str], line: str, header: str
) -> list[float]:
    """Return the numbers in three columns of a row; NaN if the third is empty."""
    missing = set(columns[:2]) - row.keys()
    if missing:
        expected = f"the columns {columns[0]}, {columns[1]} and, if there is one, {columns[2]}"
        raise InvalidInputError(header, [str(name) for name in row], expected)
    names = columns if row.get(columns[2]) else columns[:2]
    point = [number(row[name], line, name) for name in names]
    check_position([*point, 0.0][:3], line)
    if columns is IN_DEGREES and not (-180 <= point[0] <= 360 and -90 <= point[1] <= 90):
        expected = "lon_deg from -180 to 360 and lat_deg from -90 to 90"
        raise InvalidInputError(line, [str(x) for x in point], expected)
    return [*point, np.nan][:3]


def _in_the_air(vehicle: DroneConfig, waypoints_m: FloatArray, heights: HeightLookup) -> FloatArray:
    """Return (K, 3) waypoints at the height that the configuration asks for."""
    if vehicle.height_above_ground_m is not None:
        flat = np.column_stack((waypoints_m[:, :2], np.zeros(len(waypoints_m))))
        flat[:, 2] = heights(flat).ground_height_m + vehicle.height_above_ground_m
        expected = "waypoints on the stage, for a height above its ground"
        waypoints_m = flat
    else:
        expected = "(x, y, z), or vehicle.height_above_ground_m"
    is_known = np.isfinite(waypoints_m[:, 2])
    if not is_known.all():
        x, y, _ = waypoints_m[np.argmin(is_known)].tolist()
        raise InvalidInputError("drive.waypoints_m", (x, y), expected)
    return waypoints_m
