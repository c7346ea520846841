"""The interface of planners: what they are given and what they return."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.geometry import pose_to_matrix
from oaisys_core.types import FloatArray, PinholeIntrinsics, Pose
from oaisys_mapping.exploration.gain import ViewScorer
from oaisys_mapping.exploration.occupancy_map import OccupancyMap
from oaisys_mapping.exploration.roadmap import Roadmap

ROADMAP_SIZES = (0, 1000, 5000)
"""Numbers of random positions in the roadmaps that are tried until one contains a path."""


@dataclass(frozen=True)
class Vehicle:
    """A flying vehicle with a camera.

    Attributes:
        intrinsics: The camera, rectified.
        T_base_camera: (4, 4) pose of the camera's optical frame in the vehicle's frame.
        radius_m: Radius of the ball around the vehicle that must be free.
        max_range_m: Depth up to which the camera's images are used.
    """

    intrinsics: PinholeIntrinsics
    T_base_camera: FloatArray
    radius_m: float = 1.0
    max_range_m: float = 20.0


@dataclass
class Situation:
    """Everything a planner knows when it chooses the next view.

    Attributes:
        vehicle: The vehicle.
        voxels: The map of observations.
        visited: Poses of the views so far; the vehicle is at the last one.
        rng: The planner's random generator.
    """

    vehicle: Vehicle
    voxels: OccupancyMap
    visited: Sequence[Pose]
    rng: np.random.Generator
    _roadmaps: list[tuple[FloatArray, Roadmap]] = field(
        default_factory=list, init=False, repr=False
    )

    @property
    def here_m(self) -> FloatArray:
        """(3,) position of the vehicle."""
        return np.asarray(self.visited[-1].position_m)

    @cached_property
    def clearance_m(self) -> NDArray[np.float32]:
        """See `OccupancyMap.clearance_m`."""
        return self.voxels.clearance_m()

    @cached_property
    def safe_cells(self) -> NDArray[np.intp]:
        """(N, 3) voxels in which the vehicle may be."""
        return np.argwhere(self.clearance_m >= self.vehicle.radius_m + self.voxels.voxel_size_m)

    @cached_property
    def frontier_m(self) -> FloatArray:
        """(N, 3) centres of the voxels at surface frontiers."""
        return self.voxels.centers_m(np.argwhere(self.voxels.surface_frontier()))

    @cached_property
    def scorer(self) -> ViewScorer:
        """Scores views by their gain."""
        vehicle = self.vehicle
        return ViewScorer(self.voxels, vehicle.intrinsics, vehicle.max_range_m)

    def roadmap(self, positions_m: FloatArray) -> Roadmap:
        """Return the shortest paths through known free space from here to (N, 3) positions."""
        roadmap = Roadmap(
            self.voxels, self.clearance_m, self.vehicle.radius_m, self.here_m, positions_m
        )
        self._roadmaps.append((positions_m, roadmap))
        return roadmap

    def path_m(self, position_m: FloatArray) -> FloatArray | None:
        """Return the (K, 3) waypoints of a path from here to a (3,) position; None if unknown.

        If the planner asked for paths to that position, its path is returned.
        """
        for positions_m, roadmap in self._roadmaps:
            here = np.flatnonzero((positions_m == position_m).all(axis=1))
            if len(here) and np.isfinite(roadmap.lengths_m[here[0]]):
                return roadmap.path_m(int(here[0]))
        for size in ROADMAP_SIZES:
            roadmap = self.roadmap(np.vstack((position_m, self.random_positions(size))))
            if np.isfinite(roadmap.lengths_m[0]):
                return roadmap.path_m(0)
        return None

    def random_positions(self, count: int) -> FloatArray:
        """Return up to (count, 3) positions in known free space."""
        cells = self.safe_cells
        if not len(cells):
            return np.empty((0, 3))
        chosen = self.rng.choice(len(cells), min(count, len(cells)), replace=False)
        return self.voxels.centers_m(cells[chosen])

    def gains(self, poses: Sequence[Pose]) -> FloatArray:
        """Return the (N,) gains of views from poses of the vehicle."""
        T_map_camera = [pose_to_matrix(pose) @ self.vehicle.T_base_camera for pose in poses]
        return self.scorer.scores(np.array(T_map_camera).reshape(-1, 4, 4))


class Planner(ABC):
    """Chooses views one after the other."""

    name: str

    @abstractmethod
    def next_pose(self, situation: Situation) -> Pose | None:
        """Return the next pose, in reachable known free space; None if there is nothing to gain."""


def level_pose(position_m: ArrayLike, yaw_rad: float) -> Pose:
    """Return the pose of a level vehicle with a heading in radians about z."""
    half = yaw_rad / 2
    quat_xyzw = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
    x, y, z = (float(value) for value in np.asarray(position_m))
    return Pose((x, y, z), quat_xyzw)


def level_poses_towards(positions_m: FloatArray, targets_m: FloatArray) -> list[Pose]:
    """Return level poses at (N, 3) positions with headings towards (N, 3) targets."""
    ways = targets_m - positions_m
    yaws = np.arctan2(ways[:, 1], ways[:, 0])
    return [level_pose(p, float(yaw)) for p, yaw in zip(positions_m, yaws, strict=True)]
