"""Trajectories of movers: the pose at each sample, or at a simulated time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from oaisys_core.config.sections.objects import TrajectoryConfig
from oaisys_core.geometry import distances_along_m, pose_to_matrix, transform
from oaisys_core.geometry.places import waypoints_in_map
from oaisys_core.output.poses import read_poses
from oaisys_core.types import FloatArray, Georeference

SMOOTH_STEPS = 64
"""Number of straight pieces of a spline between two waypoints."""


class MoverTrajectory(Protocol):
    """Where a mover is at each sample."""

    def __call__(self, sample_id: int, time_s: float | None) -> FloatArray:
        """Return the (4, 4) pose at a sample id, 0 at the start of the batch.

        With a simulated time in seconds, which is None outside of timed drives, it is the pose at
        that time if the mover has a speed.
        """

    @property
    def way_m(self) -> FloatArray:
        """(K, 3) points of the whole way, once around if it is closed."""

    def way_behind_m(self, sample_id: int, time_s: float | None) -> float:
        """Return how much of the way, from its start, lies behind the mover, as for the pose."""


def make_trajectory(
    config: TrajectoryConfig, georeference: Georeference | None = None, field: str = "trajectory"
) -> MoverTrajectory:
    """Return the trajectory of a configuration.

    Args:
        config: The configuration.
        georeference: Where the ground lies on its body, for waypoints in degrees.
        field: Name of the configuration in errors.

    Raises:
        InvalidInputError: The CSV file cannot be read, or does not contain poses; or the ground is
            of no place.
    """
    if config.csv is not None:
        poses = [pose_to_matrix(pose) for pose in read_poses(config.csv)]
        return _PoseList(np.array(poses), config.closed)
    points = np.array([(*point, 0.0)[:3] for point in config.waypoints_m])
    if config.waypoints_lon_lat_deg:
        name = f"{field}.waypoints_lon_lat_deg"
        points = waypoints_in_map(georeference, config.waypoints_lon_lat_deg, name)
        points = np.nan_to_num(points)
    if config.closed:
        points = np.vstack((points, points[:1]))
    if config.smooth:
        points = _spline(points, config.closed)
    return _MoverPath(points, config.closed, config.start_m, config.step_m, config.speed_m_s)


@dataclass(frozen=True)
class _PoseList:
    """A trajectory through a list of poses."""

    T_map_body: FloatArray
    closed: bool

    @property
    def way_m(self) -> FloatArray:
        """See `MoverTrajectory`."""
        return np.asarray(self.T_map_body[:, :3, 3])

    def way_behind_m(self, sample_id: int, time_s: float | None) -> float:
        """See `MoverTrajectory`."""
        steps_m = np.linalg.norm(np.diff(self.way_m[:, :2], axis=0), axis=1)
        return float(steps_m[:sample_id].sum())

    def __call__(self, sample_id: int, time_s: float | None) -> FloatArray:
        """See `MoverTrajectory`."""
        count = len(self.T_map_body)
        row = sample_id % count if self.closed else min(sample_id, count - 1)
        return np.asarray(self.T_map_body[row])


@dataclass(frozen=True)
class _MoverPath:
    """A trajectory along (K, 3) points at constant speed, with the x axis forward."""

    points_m: FloatArray
    closed: bool
    start_m: float
    step_m: float
    speed_m_s: float | None

    @property
    def way_m(self) -> FloatArray:
        """See `MoverTrajectory`."""
        return self.points_m

    def way_behind_m(self, sample_id: int, time_s: float | None) -> float:
        """See `MoverTrajectory`."""
        moved_m = sample_id * self.step_m
        if time_s is not None and self.speed_m_s is not None:
            moved_m = time_s * self.speed_m_s
        return self.start_m + moved_m

    def __call__(self, sample_id: int, time_s: float | None) -> FloatArray:
        """See `MoverTrajectory`."""
        from scipy.spatial.transform import Rotation

        pieces = np.diff(self.points_m, axis=0)
        lengths_m = np.linalg.norm(pieces, axis=1)
        ends_m = np.cumsum(lengths_m)
        path_m = self.way_behind_m(sample_id, time_s)
        path_m = path_m % ends_m[-1] if self.closed else min(path_m, ends_m[-1])
        piece = min(int(np.searchsorted(ends_m, path_m, side="right")), len(pieces) - 1)
        share = (path_m - (ends_m[piece] - lengths_m[piece])) / lengths_m[piece]
        position_m = self.points_m[piece] + share * pieces[piece]
        x, y, z = pieces[piece]
        angles = (np.arctan2(y, x), -np.arctan2(z, np.hypot(x, y)))
        return transform(Rotation.from_euler("ZY", angles).as_matrix(), position_m)


def _spline(points_m: FloatArray, closed: bool) -> FloatArray:
    """Return points on a cubic spline through (K, 3) points."""
    knots = distances_along_m(points_m)
    curve = scipy.interpolate.CubicSpline(
        knots, points_m, bc_type="periodic" if closed else "natural"
    )
    steps = np.linspace(0, 1, SMOOTH_STEPS, endpoint=False)
    between = (knots[:-1, None] + np.diff(knots)[:, None] * steps).ravel()
    return np.asarray(curve(np.append(between, knots[-1])))
