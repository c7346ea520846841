"""What every planner of views is given and must answer."""

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

MORE_PLACES = (0, 1000, 5000)
"""Places among which a way is looked for, one after the other, where none is known yet."""


@dataclass(frozen=True)
class Vehicle:
    """What flies.

    Attributes:
        intrinsics: Of its camera, rectified.
        T_base_camera: (4, 4) pose of the camera's optical frame on the vehicle.
        radius_m: The ball around the vehicle's position that must be free.
        max_range_m: How far its camera's depth is used.
    """

    intrinsics: PinholeIntrinsics
    T_base_camera: FloatArray
    radius_m: float = 1.0
    max_range_m: float = 20.0


@dataclass
class Situation:
    """All that a planner knows when it is asked.

    Attributes:
        voxels: What was observed.
        visited: Poses of the views so far, the last one being where the vehicle is.
        rng: The planner's own.
    """

    vehicle: Vehicle
    voxels: OccupancyMap
    visited: Sequence[Pose]
    rng: np.random.Generator
    _found: list[tuple[FloatArray, Roadmap]] = field(default_factory=list, init=False, repr=False)

    @property
    def here_m(self) -> FloatArray:
        """(3,) where the vehicle is."""
        return np.asarray(self.visited[-1].position_m)

    @cached_property
    def clearance_m(self) -> NDArray[np.float32]:
        """See `OccupancyMap.clearance_m`."""
        return self.voxels.clearance_m()

    @cached_property
    def safe_cells(self) -> NDArray[np.intp]:
        """(N, 3) voxels in which the vehicle may stand."""
        return np.argwhere(self.clearance_m >= self.vehicle.radius_m + self.voxels.voxel_size_m)

    @cached_property
    def frontier_m(self) -> FloatArray:
        """(N, 3) centres of the voxels where a seen surface goes on unseen."""
        return self.voxels.centers_m(np.argwhere(self.voxels.surface_frontier()))

    @cached_property
    def scorer(self) -> ViewScorer:
        """Scores views by what they would add."""
        vehicle = self.vehicle
        return ViewScorer(self.voxels, vehicle.intrinsics, vehicle.max_range_m)

    def roadmap(self, positions_m: FloatArray) -> Roadmap:
        """Return the ways through known free space from here to (N, 3) positions."""
        roadmap = Roadmap(
            self.voxels, self.clearance_m, self.vehicle.radius_m, self.here_m, positions_m
        )
        self._found.append((positions_m, roadmap))
        return roadmap

    def path_m(self, position_m: FloatArray) -> FloatArray | None:
        """Return the (K, 3) places on a way from here to a (3,) position; None: none is known.

        Where a planner has asked for the ways to that position, it is the one that it was told.
        """
        for positions_m, roadmap in self._found:
            here = np.flatnonzero((positions_m == position_m).all(axis=1))
            if len(here) and np.isfinite(roadmap.lengths_m[here[0]]):
                return roadmap.path_m(int(here[0]))
        for places in MORE_PLACES:
            roadmap = self.roadmap(np.vstack((position_m, self.random_positions(places))))
            if np.isfinite(roadmap.lengths_m[0]):
                return roadmap.path_m(0)
        return None

    def random_positions(self, count: int) -> FloatArray:
        """Return up to (count, 3) places in known free space."""
        cells = self.safe_cells
        if not len(cells):
            return np.empty((0, 3))
        chosen = self.rng.choice(len(cells), min(count, len(cells)), replace=False)
        return self.voxels.centers_m(cells[chosen])

    def gains(self, poses: Sequence[Pose]) -> FloatArray:
        """Return (N,) what views from poses of the vehicle would add."""
        T_map_camera = [pose_to_matrix(pose) @ self.vehicle.T_base_camera for pose in poses]
        return self.scorer.scores(np.array(T_map_camera).reshape(-1, 4, 4))


class Planner(ABC):
    """Names the next pose to look from."""

    name: str

    @abstractmethod
    def next_pose(self, situation: Situation) -> Pose | None:
        """Return where to look from next, in known free space and within reach, or None: done."""


def level_pose(position_m: ArrayLike, yaw_rad: float) -> Pose:
    """Return the pose of a level vehicle that looks along its x axis."""
    half = yaw_rad / 2
    quat_xyzw = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
    x, y, z = (float(value) for value in np.asarray(position_m))
    return Pose((x, y, z), quat_xyzw)


def level_poses_towards(positions_m: FloatArray, targets_m: FloatArray) -> list[Pose]:
    """Return level poses at (N, 3) positions, turned towards (N, 3) targets."""
    ways = targets_m - positions_m
    yaws = np.arctan2(ways[:, 1], ways[:, 0])
    return [level_pose(p, float(yaw)) for p, yaw in zip(positions_m, yaws, strict=True)]
