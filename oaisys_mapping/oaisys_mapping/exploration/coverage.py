"""Coverage: the share of the reachable surface that views have seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.types import FloatArray, Pose, TriangleMesh
from oaisys_mapping.evaluation.visibility import PosedCamera, raycasting_scene, visible_from_any
from oaisys_mapping.exploration.occupancy_map import Bounds
from oaisys_mapping.exploration.planner import Vehicle, level_pose
from oaisys_mapping.mesh import SurfacePoints, sample_surface

MAX_POINTS = 60_000
"""Points on the true surface at most."""

MAX_DRAWS = 200
"""Draws of random poses after which a box counts as having no room."""

Clearance = Callable[[FloatArray], FloatArray]
"""Returns the (N,) heights in metres of (N, 3) points above the true surface."""


def random_poses(
    bounds: Bounds, vehicle: Vehicle, clearance_m: Clearance, count: int, rng: np.random.Generator
) -> list[Pose]:
    """Return ``count`` random level poses in a box at which a vehicle is truly free.

    Raises:
        InvalidInputError: There is hardly any room in the box.
    """
    low_m = np.asarray(bounds.low_m) + vehicle.radius_m
    high_m = np.asarray(bounds.high_m) - vehicle.radius_m
    poses: list[Pose] = []
    for _ in range(MAX_DRAWS):
        if (low_m >= high_m).any():
            break
        points_m = rng.uniform(low_m, high_m, (count, 3))
        yaws_rad = rng.uniform(-np.pi, np.pi, count)
        free = clearance_m(points_m) >= vehicle.radius_m
        poses += [level_pose(p, y) for p, y in zip(points_m[free], yaws_rad[free], strict=True)]
        if len(poses) >= count:
            return poses[:count]
    raise InvalidInputError("bounds", (low_m.tolist(), high_m.tolist()), "a box with room to fly")


class SurfaceCoverage:
    """Tracks which reachable points of the true surface views have seen.

    Attributes:
        reachable: Points visible from at least one of the poses given at the start.
        reachable_share: Their share of all points.
        seen: (N,) which of them some view has seen so far.
    """

    def __init__(
        self,
        truth: TriangleMesh,
        vehicle: Vehicle,
        poses: Sequence[Pose],
        spacing_m: float,
        rng: np.random.Generator,
    ) -> None:
        """Sample points on the truth and keep those visible from any of ``poses``."""
        self._vehicle = vehicle
        self._scene = raycasting_scene(truth.vertices_m, truth.triangles)
        points = sample_surface(truth.vertices_m, truth.triangles, spacing_m, MAX_POINTS, rng)
        reachable = self._visible(points, poses)
        if not reachable.any():
            received = f"{len(poses)} drawn poses, from none of which the camera sees ground"
            expected = f"ground within {vehicle.max_range_m:g} m of the camera as it is mounted"
            raise InvalidInputError("poses", received, expected)
        self.reachable: SurfacePoints = points.only(reachable)
        self.reachable_share = float(reachable.mean())
        self.seen = np.zeros(len(self.reachable.points_m), bool)

    def add(self, pose: Pose) -> float:
        """Add the view from a pose of the vehicle; return the share seen so far."""
        left = np.flatnonzero(~self.seen)
        found = self._visible(self.reachable.only(~self.seen), [pose])
        self.seen[left[found]] = True
        return float(self.seen.mean())

    def forget(self) -> None:
        """Forget all views."""
        self.seen[:] = False

    def _visible(self, points: SurfacePoints, poses: Sequence[Pose]) -> NDArray[np.bool_]:
        vehicle = self._vehicle
        views = [
            PosedCamera(vehicle.intrinsics, pose_to_matrix(pose) @ vehicle.T_base_camera)
            for pose in poses
        ]
        return visible_from_any(points, views, self._scene, vehicle.max_range_m)
