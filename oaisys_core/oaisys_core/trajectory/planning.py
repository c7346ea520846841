"""From the configuration's section ``drive`` to a trajectory."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oaisys_core.config.sections.drive import (
    DriveConfig,
    DroneConfig,
    RecordedMotionConfig,
    RoverConfig,
)
from oaisys_core.errors import InvalidInputError
from oaisys_core.modules.clearance import HeightLookup
from oaisys_core.trajectory.drone import plan_flight
from oaisys_core.trajectory.files import read_trajectory
from oaisys_core.trajectory.rover import Obstacle, plan_rover_drive
from oaisys_core.trajectory.trajectory import Trajectory
from oaisys_core.types import FloatArray


@dataclass(frozen=True)
class DrivePlan:
    """A planned drive.

    Attributes:
        trajectory: The motion of ``base_link``.
        end_s: Time at which the drive ends, on or before the trajectory's end.
        obstacle: What a rover stops in front of; None for no obstacle.
    """

    trajectory: Trajectory
    end_s: float
    obstacle: Obstacle | None = None

    def length_m(self) -> float:
        """Return the length of the way that is driven."""
        times_s = np.linspace(self.trajectory.start_s, self.end_s, 10_001)
        steps_m = np.diff(self.trajectory.position_m(times_s), axis=0)
        return float(np.linalg.norm(steps_m, axis=1).sum())


def plan_drive(config: DriveConfig, heights: HeightLookup) -> DrivePlan:
    """Return the drive that a configuration describes.

    Args:
        config: Vehicle and waypoints.
        heights: Looks up ground and topmost surface below (N, 3) points in ``map``.

    Raises:
        InvalidInputError: A file cannot be read, or the vehicle cannot drive this way.
    """
    obstacle = None
    vehicle = config.vehicle
    if isinstance(vehicle, RecordedMotionConfig):
        trajectory = read_trajectory(vehicle.path)
    elif isinstance(vehicle, RoverConfig):
        plan = plan_rover_drive(vehicle, _waypoints_m(config)[:, :2], heights)
        trajectory, obstacle = plan.trajectory, plan.obstacle
    else:
        waypoints_m = _in_the_air(vehicle, _waypoints_m(config), heights)
        trajectory = plan_flight(vehicle, waypoints_m, config.gravity_m_s2)
    end_s = trajectory.end_s
    if config.duration_s is not None:
        end_s = min(end_s, trajectory.start_s + config.duration_s)
    return DrivePlan(trajectory, end_s, obstacle)


def _waypoints_m(config: DriveConfig) -> FloatArray:
    """Return (K, 3) waypoints; z is NaN where none is given."""
    if config.waypoints_file is not None:
        return read_waypoints(config.waypoints_file)
    return np.array([(*point, np.nan)[:3] for point in config.waypoints_m])


def read_waypoints(path: Path) -> FloatArray:
    """Return the (K, 3) waypoints of a CSV file with the columns x_m, y_m and perhaps z_m.

    Without z_m, z is NaN.

    Raises:
        InvalidInputError: The file cannot be read, or a row has no numbers; names line and value.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError) as error:
        expected = f"a readable CSV file ({error})"
        raise InvalidInputError("drive.waypoints_file", str(path), expected) from error
    points = []
    for line, row in enumerate(rows, start=2):
        try:
            point = [float(row[column]) for column in ("x_m", "y_m")]
            point.append(float(row["z_m"]) if row.get("z_m") else np.nan)
        except (KeyError, TypeError, ValueError) as error:
            expected = "numbers in the columns x_m, y_m and, if there is one, z_m"
            raise InvalidInputError(f"{path}:{line}", dict(row), expected) from error
        if not np.isfinite(point[:2]).all() or np.isinf(point[2]):
            raise InvalidInputError(f"{path}:{line}", dict(row), "finite numbers")
        points.append(point)
    if not points:
        raise InvalidInputError("drive.waypoints_file", str(path), "rows below the header")
    return np.array(points)


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
