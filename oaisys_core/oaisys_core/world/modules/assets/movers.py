"""Objects that move along trajectories, and the tracks that rovers leave."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from oaisys_core.procedural.scatter.placement.ground_pose import pose_on_ground
from oaisys_core.procedural.scatter.trajectories import MoverTrajectory
from oaisys_core.procedural.scatter.vehicles import WHEEL_WIDTH, WHEEL_Y
from oaisys_core.scene import Ground, WheelTracks
from oaisys_core.types import FloatArray


@dataclass(frozen=True)
class Mover:
    """A placement that moves along a trajectory.

    Attributes:
        index: Index into `DrawnAssets.placements`.
        foot_m: Radius of its foot if it stands on the ground; None otherwise.
        leaves_tracks: Whether it is a rover on the ground.
    """

    index: int
    trajectory: MoverTrajectory
    scale: float
    foot_m: float | None
    leaves_tracks: bool = False

    def pose_at(self, sample_id: int, ground: Ground, time_s: float | None = None) -> FloatArray:
        """Return the (4, 4) pose with scale at a sample, or at a time: `MoverTrajectory`."""
        T = self.trajectory(sample_id, time_s)
        if self.foot_m is not None:
            yaw_rad = float(np.arctan2(T[1, 0], T[0, 0]))
            T = pose_on_ground(ground, (T[0, 3], T[1, 3]), yaw_rad, self.foot_m)
        return scale_pose(T, self.scale)

    @cached_property
    def _way_m(self) -> FloatArray:
        return np.asarray(self.trajectory.way_m[:, :2])

    def tracks_at(self, sample_id: int, time_s: float | None = None) -> WheelTracks:
        """Return the tracks at a sample, or at a time; the points are always the same array."""
        length_m = np.linalg.norm(np.diff(self._way_m, axis=0), axis=1).sum()
        share = self.trajectory.way_behind_m(sample_id, time_s) / max(length_m, 1e-9)
        wheel_y_m, width_m = self.scale * WHEEL_Y, self.scale * WHEEL_WIDTH
        return WheelTracks(self._way_m, wheel_y_m, width_m, min(float(share), 1.0))


def scale_pose(T_map_object: FloatArray, scale: float) -> FloatArray:
    """Return a (4, 4) pose with its rotation multiplied by a scale."""
    T = T_map_object.copy()
    T[:3, :3] *= scale
    return T
