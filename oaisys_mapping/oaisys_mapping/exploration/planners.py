"""The built-in planners: next best view and its baselines."""

from __future__ import annotations

from importlib.metadata import entry_points

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, one_of, quote
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.planner import (
    Planner,
    Situation,
    Vehicle,
    level_pose,
    level_poses_towards,
)

ENTRY_POINTS = "oaisys.planners"
"""Entry point group under which other packages offer planners by name."""

CANDIDATES = 200
"""Views that are scored each time."""

MAX_DRAWS = 3
"""Draws of candidates without any gain after which exploration ends."""

POSITIONS = 1000
"""Random positions among which vantage points are searched."""

MIN_VANTAGE_M = 2.0
MAX_VANTAGE_SHARE = 0.6
"""Distances from which a frontier is viewed: at least so many metres, and at most this share of the
camera's range."""

REGION_M = 3.0
MIN_REGION_VOXELS = 5
"""A frontier region is a cube of this size with at least so many frontier voxels."""

MIN_GAIN = 0.5
"""Views with a smaller gain count as having none."""


class RandomPlanner(Planner):
    """Chooses random poses in known free space."""

    name = "random"

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return a random reachable position with a random heading."""
        positions_m = situation.random_positions(CANDIDATES)
        reachable = np.isfinite(situation.roadmap(positions_m).lengths_m)
        if not reachable.any():
            return None
        return level_pose(positions_m[reachable][0], float(situation.rng.uniform(-np.pi, np.pi)))


class GridPlanner(Planner):
    """Flies a lawnmower pattern over the box with four headings at each position.

    Attributes:
        spacing_m: Distance between the positions of the grid.
    """

    name = "grid"

    def __init__(self, spacing_m: float = 8.0) -> None:
        self.spacing_m = spacing_m
        self._remaining: list[tuple[float, float, float]] | None = None

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return the next of the grid's views that is reachable by now."""
        if self._remaining is None:
            self._remaining = self._grid(situation)
        positions_m = situation.random_positions(POSITIONS)
        lengths_m = situation.roadmap(positions_m).lengths_m
        positions_m = positions_m[np.isfinite(lengths_m)]
        for index, (x_m, y_m, yaw_rad) in enumerate(self._remaining):
            away_m = np.hypot(positions_m[:, 0] - x_m, positions_m[:, 1] - y_m)
            near = np.flatnonzero(away_m < self.spacing_m / 3)
            if len(near):
                del self._remaining[index]
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
    """Chooses a view of the nearest frontier between known and unknown space.

    Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997.
    """

    name = "frontier"

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return a reachable pose that views the nearest frontier."""
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
            sees = np.flatnonzero(situation.gains(some) >= MIN_GAIN)
            if len(sees):
                return some[int(sees[0])]
        return None


def _frontier_regions(frontier_m: FloatArray) -> FloatArray:
    """Return the (K, 3) centroids of regions among (N, 3) frontier voxels."""
    cubes = np.floor(frontier_m / REGION_M).astype(np.intp)
    _, region, counts = np.unique(cubes, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(region.reshape(-1), frontier_m[:, i], len(counts)) for i in range(3)]
    centroids_m = np.column_stack(sums) / counts[:, None]
    return np.asarray(centroids_m[counts >= MIN_REGION_VOXELS])


class NextBestViewPlanner(Planner):
    """Chooses the view with the highest gain, discounted by the length of the path to it.

    Attributes:
        discount_length_m: Path length after which a gain counts 1/e.
    """

    name = "next_best_view"

    def __init__(self, discount_length_m: float = 40.0) -> None:
        self.discount_length_m = discount_length_m

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return the best of many reachable views, most of them directed at frontiers.

        None only if several draws of candidates have no gain.
        """
        for _ in range(MAX_DRAWS):
            poses = self._candidates(situation)
            if not poses:
                return None
            positions_m = np.array([pose.position_m for pose in poses])
            lengths_m = situation.roadmap(positions_m).lengths_m
            reachable = np.flatnonzero(np.isfinite(lengths_m))
            gains = situation.gains([poses[index] for index in reachable])
            if len(gains) and gains.max() >= MIN_GAIN:
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
    """Choose for each of (K, 3) targets one of (N, 3) positions from which it is in the image.

    Returns:
        (M,) indices of positions, and (M,) indices of the targets that have one.
    """
    to_target_m = targets_m[:, None] - positions_m[None]
    across_m = np.hypot(to_target_m[..., 0], to_target_m[..., 1])
    ahead, camera = vehicle.T_base_camera[:3, 2], vehicle.intrinsics
    up_rad, down_rad = (
        np.arctan2(ahead[2], ahead[0]) + np.arctan(edge_px / camera.fy_px)
        for edge_px in (camera.cy_px, camera.cy_px - camera.height_px)
    )
    elevation_rad = np.arctan2(to_target_m[..., 2], across_m)
    fits = (elevation_rad > down_rad) & (elevation_rad < up_rad)
    fits &= (across_m > MIN_VANTAGE_M) & (across_m < MAX_VANTAGE_SHARE * vehicle.max_range_m)
    found = np.flatnonzero(fits.any(axis=1))
    chosen = np.where(fits, rng.random(fits.shape), -1.0).argmax(axis=1)
    return chosen[found], found


BUILT_IN_PLANNERS: dict[str, type[Planner]] = {
    kind.name: kind for kind in (NextBestViewPlanner, FrontierPlanner, GridPlanner, RandomPlanner)
}


def require_planner(name: str) -> None:
    """Raise `InvalidInputError` unless there is a planner of this name; it is not imported."""
    names = {*BUILT_IN_PLANNERS, *(point.name for point in entry_points(group=ENTRY_POINTS))}
    if name not in names:
        raise InvalidInputError("planner", name, one_of(names, name))


def make_planner(name: str) -> Planner:
    """Return a built-in planner, or one that an installed package offers under `ENTRY_POINTS`.

    Raises:
        InvalidInputError: There is no planner of that name, or it is none.
    """
    require_planner(name)
    if name in BUILT_IN_PLANNERS:
        return BUILT_IN_PLANNERS[name]()
    (found, *_) = entry_points(group=ENTRY_POINTS, name=name)
    kind = found.load()
    if not (isinstance(kind, type) and issubclass(kind, Planner)):
        raise InvalidInputError(f"planner {quote(name)}", kind, "a subclass of Planner")
    return kind()
