"""Policies to compare others with: each is called with an observation and returns an action."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_gym.coverage import REACH_M, Coverage
from oaisys_gym.drive_to_goal import DriveToGoal
from oaisys_gym.flight import FlightEnv, scale_pose
from oaisys_gym.next_best_view import NextBestView
from oaisys_gym.terrain_env import Action, Observation
from oaisys_mapping.exploration.planner import level_pose
from oaisys_mapping.exploration.planners import make_planner

DISCOUNT_LENGTH_M = 40.0
"""Length of a way after which a gain counts 1/e, as `NextBestViewPlanner` has it."""


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


class BestWaypoint:
    """Flies in `Coverage` to the waypoint whose view promises most to the map, near ones first.

    Gains are those of `oaisys_mapping.exploration.gain`, at the present height. Where none of them
    is worth anything, it flies on at random.
    """

    STEPS_M = (0.5, 3.0, 6.0, 8.0)
    MIN_GAIN = 1.0

    def __init__(self, environment: gymnasium.Env[Any, Action], seed: int = 0) -> None:
        """Take the environment, and the seed of flights at random.

        Raises:
            InvalidInputError: It is another one.
        """
        self._environment = _flight_of(environment, Coverage)
        self._rng = np.random.default_rng(seed)
        angles_rad = np.arange(16) * np.pi / 8
        directions = np.column_stack((np.cos(angles_rad), np.sin(angles_rad)))
        self._ways_m = np.concatenate([directions * step_m for step_m in self.STEPS_M])

    def __call__(self, _observation: Observation) -> Action:
        """Return the way to the best waypoint."""
        situation = self._environment.situation
        low_m, high_m = self._environment.extent_m
        ends_m = situation.here_m[:2] + self._ways_m
        ways_m = self._ways_m[((ends_m > low_m + 1) & (ends_m < high_m - 1)).all(axis=1)]
        places_m = situation.here_m + np.column_stack((ways_m, np.zeros(len(ways_m))))
        poses = [
            level_pose(place_m, float(np.arctan2(y_m, x_m)))
            for place_m, (x_m, y_m) in zip(places_m, ways_m, strict=True)
        ]
        gains = situation.gains(poses)
        if not len(gains) or gains.max() < self.MIN_GAIN:
            return self._rng.uniform(-1, 1, 2).astype(np.float32)
        utility = gains * np.exp(-np.linalg.norm(ways_m, axis=1) / DISCOUNT_LENGTH_M)
        return np.asarray(ways_m[int(utility.argmax())] / REACH_M, np.float32)


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
