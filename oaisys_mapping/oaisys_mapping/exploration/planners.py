"""The planners that come with it: next best view, and what it is measured against."""

from __future__ import annotations

from importlib.metadata import entry_points

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.planner import (
    Planner,
    Situation,
    Vehicle,
    level_pose,
    level_poses_towards,
)

ENTRY_POINTS = "oaisys.planners"
"""Group under which other packages offer planners by name."""

CANDIDATES = 200
"""Views that are scored each time."""

DRAWS = 3
"""So often candidates are drawn before there is nothing to gain."""

POSITIONS = 1000
"""Places among which vantage points are looked for."""

NEAREST_M = 2.0
VANTAGE_SHARE = 0.6
"""A frontier is looked at from this far, and from within this share of the camera's range."""

REGION_M = 3.0
REGION_VOXELS = 5
"""A frontier is a cube of this size with at least so many voxels of it."""

LEAST_GAIN = 0.5
"""A view that adds less counts as one that adds nothing."""


class RandomPlanner(Planner):
    """Looks anywhere from anywhere that is known to be free."""

    name = "random"

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return a place that can be reached, with any heading."""
        positions_m = situation.random_positions(CANDIDATES)
        reachable = np.isfinite(situation.roadmap(positions_m).lengths_m)
        if not reachable.any():
            return None
        return level_pose(positions_m[reachable][0], float(situation.rng.uniform(-np.pi, np.pi)))


class GridPlanner(Planner):
    """Goes to and fro over the box, looking to four sides, as high as the way is known to be free.

    Attributes:
        spacing_m: Between the places of the grid.
    """

    name = "grid"

    def __init__(self, spacing_m: float = 8.0) -> None:
        self.spacing_m = spacing_m
        self._left: list[tuple[float, float, float]] | None = None

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return the next of the grid's views that can be reached by now."""
        if self._left is None:
            self._left = self._grid(situation)
        positions_m = situation.random_positions(POSITIONS)
        lengths_m = situation.roadmap(positions_m).lengths_m
        positions_m = positions_m[np.isfinite(lengths_m)]
        for index, (x_m, y_m, yaw_rad) in enumerate(self._left):
            away_m = np.hypot(positions_m[:, 0] - x_m, positions_m[:, 1] - y_m)
            near = np.flatnonzero(away_m < self.spacing_m / 3)
            if len(near):
                del self._left[index]
                return level_pose(positions_m[near[away_m[near].argmin()]], yaw_rad)
        return None

    def _grid(self, situation: Situation) -> list[tuple[float, float, float]]:
        low_m, high_m = situation.voxels.bounds.low_m[:2], situation.voxels.bounds.high_m[:2]
        counts = np.maximum(1, np.floor((high_m - low_m) / self.spacing_m)).astype(int)
        x_m, y_m = (
            low + (np.arange(n) + 0.5) * (high - low) / n
            for low, high, n in zip(low_m, high_m, counts, strict=True)
        )
        views = []
        for row, y in enumerate(y_m):
            for x in x_m if row % 2 == 0 else x_m[::-1]:
                views += [(float(x), float(y), quarter * np.pi / 2) for quarter in range(4)]
        return views


class FrontierPlanner(Planner):
    """Looks at the nearest border between what is known and what is not.

    Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997.
    """

    name = "frontier"

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return a reachable place from which the nearest frontier is seen, turned to it."""
        positions_m = situation.random_positions(POSITIONS)
        positions_m = positions_m[np.isfinite(situation.roadmap(positions_m).lengths_m)]
        if not len(positions_m):
            return None
        targets_m = _frontier_regions(situation.frontier_m)
        away_m = np.linalg.norm(targets_m - situation.here_m, axis=1)
        targets_m = targets_m[np.argsort(away_m)]
        chosen, found = vantage_points(positions_m, targets_m, situation.vehicle, situation.rng)
        poses = level_poses_towards(positions_m[chosen], targets_m[found])
        for start in range(0, len(poses), CANDIDATES):
            some = poses[start : start + CANDIDATES]
            sees = np.flatnonzero(situation.gains(some) >= LEAST_GAIN)
            if len(sees):
                return some[int(sees[0])]
        return None


def _frontier_regions(frontier_m: FloatArray) -> FloatArray:
    """Return (K, 3) middles of cubes that hold several of (N, 3) frontier voxels."""
    cubes = np.floor(frontier_m / REGION_M).astype(np.intp)
    _, region, counts = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(region.reshape(-1), frontier_m[:, i], len(counts)) for i in range(3)]
    middles_m = np.column_stack(sums) / counts[:, None]
    return np.asarray(middles_m[counts >= REGION_VOXELS])


class NextBestViewPlanner(Planner):
    """Looks from where most is gained for the way there.

    Attributes:
        discount_length_m: After a way of this length a gain counts 1/e.
    """

    name = "next_best_view"

    def __init__(self, discount_length_m: float = 40.0) -> None:
        self.discount_length_m = discount_length_m

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return the best of many reachable views, most of them turned towards frontiers.

        None only where several draws found nothing to gain.
        """
        for _ in range(DRAWS):
            poses = self._candidates(situation)
            if not poses:
                return None
            positions_m = np.array([pose.position_m for pose in poses])
            lengths_m = situation.roadmap(positions_m).lengths_m
            reachable = np.flatnonzero(np.isfinite(lengths_m))
            gains = situation.gains([poses[index] for index in reachable])
            if len(gains) and gains.max() >= LEAST_GAIN:
                utility = gains * np.exp(-lengths_m[reachable] / self.discount_length_m)
                return poses[int(reachable[utility.argmax()])]
        return None

    def _candidates(self, situation: Situation) -> list[Pose]:
        rng = situation.rng
        positions_m = situation.random_positions(POSITIONS)
        if not len(positions_m):
            return []
        anywhere_m = positions_m[: CANDIDATES // 4]
        yaws_rad = rng.uniform(-np.pi, np.pi, len(anywhere_m))
        poses = [level_pose(p, float(y)) for p, y in zip(anywhere_m, yaws_rad, strict=True)]
        if len(situation.frontier_m):
            targets_m = rng.choice(situation.frontier_m, CANDIDATES - len(poses))
            chosen, found = vantage_points(positions_m, targets_m, situation.vehicle, rng)
            poses += level_poses_towards(positions_m[chosen], targets_m[found])
        return poses


def vantage_points(
    positions_m: FloatArray, targets_m: FloatArray, vehicle: Vehicle, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find for (K, 3) targets one of (N, 3) positions each that has it in the image, turned to it.

    Returns:
        (M,) indices of positions, and (M,) of the targets that have one.
    """
    ways_m = targets_m[:, None] - positions_m[None]
    across_m = np.hypot(ways_m[..., 0], ways_m[..., 1])
    ahead, camera = vehicle.T_base_camera[:3, 2], vehicle.intrinsics
    up_rad, down_rad = (
        np.arctan2(ahead[2], ahead[0]) + np.arctan(edge_px / camera.fy_px)
        for edge_px in (camera.cy_px, camera.cy_px - camera.height_px)
    )
    elevation_rad = np.arctan2(ways_m[..., 2], across_m)
    fits = (elevation_rad > down_rad) & (elevation_rad < up_rad)
    fits &= (across_m > NEAREST_M) & (across_m < VANTAGE_SHARE * vehicle.max_range_m)
    found = np.flatnonzero(fits.any(axis=1))
    chosen = np.where(fits, rng.random(fits.shape), -1.0).argmax(axis=1)
    return chosen[found], found


BUILT_IN_PLANNERS: dict[str, type[Planner]] = {
    kind.name: kind for kind in (NextBestViewPlanner, FrontierPlanner, GridPlanner, RandomPlanner)
}


def make_planner(name: str) -> Planner:
    """Return one of ours, or one that an installed package offers under `ENTRY_POINTS`.

    Raises:
        InvalidInputError: There is none of that name, or it is no planner.
    """
    kinds: dict[str, object] = dict(BUILT_IN_PLANNERS)
    for found in entry_points(group=ENTRY_POINTS, name=name):
        kinds.setdefault(name, found.load())
    kind = kinds.get(name)
    if not (isinstance(kind, type) and issubclass(kind, Planner)):
        names = sorted({*kinds, *(point.name for point in entry_points(group=ENTRY_POINTS))})
        raise InvalidInputError("planner", name, f"one of {', '.join(names)}")
    return kind()
