"""Policies to compare others with: each is called with an observation and returns an action."""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray
from oaisys_gym.coverage import REACH_M, Coverage
from oaisys_gym.drive_to_goal import DriveToGoal
from oaisys_gym.flight import (
    SPEED_M_S,
    SURFACE_REWARD_PER_M2,
    TIME_COST_PER_S,
    FlightEnv,
    scale_pose,
)
from oaisys_gym.next_best_view import NextBestView
from oaisys_gym.terrain_env import Action, Observation
from oaisys_mapping.exploration.planners import make_planner


class PlannerPolicy:
    """Asks a planner of `oaisys_mapping.exploration` for the next view of `NextBestView`.

    It knows the whole map that the environment has made of the depth images, not only its picture
    from above.
    """

    def __init__(
        self, environment: gymnasium.Env[Any, Action], planner: str = "next_best_view"
    ) -> None:
        """Take the environment, and the planner by its name.

        Raises:
            InvalidInputError: There is no such planner, or the environment is another one.
        """
        self._environment = _flight_of(environment, NextBestView)
        self._planner = make_planner(planner)

    def __call__(self, _observation: Observation) -> Action:
        """Return the planner's pose; the present one if it finds nothing to gain."""
        situation = self._environment.situation
        pose = self._planner.next_pose(situation) or situation.visited[-1]
        return scale_pose(pose, situation.voxels.bounds)


class MostUnseenGround:
    """Flies in `Coverage` to the waypoint whose view has the most unobserved cells of the map.

    It expects a view to show what is within ``RANGE_M`` and 30 degrees of its heading. It knows
    nothing of hills: a cell that a view should have shown counts half as much from then on.
    """

    RANGE_M = (6.0, 18.0)
    HALF_VIEW_RAD = np.pi / 6

    def __init__(self, environment: gymnasium.Env[Any, Action]) -> None:
        """Take the environment.

        Raises:
            InvalidInputError: It is another one.
        """
        self._environment = _flight_of(environment, Coverage)
        angles_rad = np.arange(16) * np.pi / 8
        directions = np.column_stack((np.cos(angles_rad), np.sin(angles_rad)))
        self._ways_m = np.concatenate([directions * step_m for step_m in (0.5, 3.0, 8.0)])
        self._hopes = np.ones(0)

    def __call__(self, observation: Observation) -> Action:
        """Return the waypoint with the best expected reward."""
        low_m, high_m = self._environment.extent_m
        here_m = low_m + (observation["pose"][:2] + 1) / 2 * (high_m - low_m)
        unseen = (observation["map"] == 0).ravel()
        if len(self._environment.situation.visited) == 1:
            self._hopes = np.ones(len(unseen))
        shape = observation["map"].shape
        size_m = (high_m - low_m) / shape
        cells_m = low_m + (np.argwhere(np.ones(shape)) + 0.5) * size_m
        ends_m = here_m + self._ways_m
        inside = ((ends_m > low_m + 1) & (ends_m < high_m - 1)).all(axis=1)
        seen = self._expected_views(ends_m, cells_m)
        found_m2 = (seen * unseen * self._hopes).sum(axis=1) * float(np.prod(size_m))
        worth = SURFACE_REWARD_PER_M2 * found_m2
        worth -= TIME_COST_PER_S * np.linalg.norm(self._ways_m, axis=1) / SPEED_M_S
        best = int(np.where(inside, worth, -np.inf).argmax())
        self._hopes[seen[best]] /= 2
        return np.asarray(self._ways_m[best] / REACH_M, np.float32)

    def _expected_views(self, ends_m: FloatArray, cells_m: FloatArray) -> NDArray[np.bool_]:
        """Return (K, N) which of (N, 2) cells are expected in the views at (K, 2) ways' ends."""
        to_cells_m = cells_m[None] - ends_m[:, None]
        distances_m = np.linalg.norm(to_cells_m, axis=2)
        headings = self._ways_m / np.linalg.norm(self._ways_m, axis=1, keepdims=True)
        ahead_m = (to_cells_m * headings[:, None]).sum(axis=2)
        near_m, far_m = self.RANGE_M
        seen = (distances_m > near_m) & (distances_m < far_m)
        seen &= ahead_m > np.cos(self.HALF_VIEW_RAD) * distances_m
        return np.asarray(seen)


class TurnToGoal:
    """Drives in `DriveToGoal` straight to the goal; where it is blocked, back and around."""

    RETREAT = ((-1.0, 0.0), (0.6, 1.0), (1.0, 0.3), (1.0, 0.0))
    """Speeds and turns after being blocked; the turns alternate in their side."""

    def __init__(self, environment: gymnasium.Env[Any, Action]) -> None:
        """Take the environment.

        Raises:
            InvalidInputError: It is another one.
        """
        if not isinstance(environment.unwrapped, DriveToGoal):
            raise InvalidInputError("environment", environment.unwrapped, "oaisys/DriveToGoal-v0")
        self._planned: list[tuple[float, float]] = []
        self._side = 1.0

    def __call__(self, observation: Observation) -> Action:
        """Return the velocity for the next second."""
        _, bearing_rad = observation["goal"]
        if observation["blocked"][0] and not self._planned:
            self._side = -self._side
            self._planned = [(speed, self._side * turn) for speed, turn in self.RETREAT]
        if self._planned:
            return np.array(self._planned.pop(0), np.float32)
        turn = float(np.clip(bearing_rad / 0.6, -1, 1))
        return np.array((max(0.0, float(np.cos(bearing_rad))), turn), np.float32)


def _flight_of(environment: gymnasium.Env[Any, Action], kind: type[FlightEnv]) -> FlightEnv:
    found = environment.unwrapped
    if not isinstance(found, kind):
        raise InvalidInputError("environment", found, f"oaisys/{kind.__name__}-v0")
    return found
