"""Seeing all of the ground from a vehicle that follows it at one height."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from oaisys_core.types import FloatArray
from oaisys_gym.flight import (
    SPEED_M_S,
    SURFACE_REWARD_PER_M2,
    TIME_COST_PER_S,
    VIEW_S,
    FlightEnv,
    check_action,
    map_from_above,
    path_length_m,
)
from oaisys_gym.terrain_env import Action, Observation
from oaisys_mapping.exploration.planner import level_pose

HEIGHT_M = 3.0
"""Height of the vehicle above ground and rocks."""

REACH_M = 8.0
"""A waypoint is at most so far away along x and along y."""

MARGIN_M = 1.0
"""Waypoints keep so far from the stage's edge."""

PATH_STEP_M = 0.5
LEAST_STEP_M = 0.1
"""A nearer waypoint leaves the vehicle where it is, and its heading as it is."""

GOAL_SHARE = 0.85


class Coverage(FlightEnv):
    """The action is the next waypoint.

    It is (2,) float32 from -1 to 1: the way along x and y of ``map``, times 8 m. The vehicle flies
    straight, 3 m above ground and rocks, and then looks along its way. Waypoints off the stage are
    moved to 1 m from its edge.

    The reward is 0.05 for each m² of ground, seen from above, that is observed for the first time,
    less 0.02 for each second of flight (2 m/s, 1 s for a view). ``info`` has ``coverage``, the
    share of the map's cells that are observed. An episode ends at a coverage of 0.85
    (``terminated``) or after 60 views (``truncated``).
    """

    def __init__(self, **options: Any) -> None:
        """See `oaisys_gym.terrain_env.TerrainEnv`."""
        super().__init__(**options)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Fly to a waypoint and look from there; see `gymnasium.Env.step`.

        Raises:
            InvalidInputError: The action is not two finite numbers.
        """
        self.require_reset()
        path_m, yaw_rad = self._way(check_action(action, 2))
        length_m = path_length_m(path_m)
        before = self._coverage()
        self._flown_m += length_m
        self._view(level_pose(path_m[-1], yaw_rad))
        coverage = self._coverage()
        area_m2 = float(np.prod(np.ptp(self.extent_m, axis=0)))
        reward = SURFACE_REWARD_PER_M2 * (coverage - before) * area_m2
        reward -= TIME_COST_PER_S * (length_m / SPEED_M_S + VIEW_S)
        return self._observe(), reward, coverage >= GOAL_SHARE, False, self._info()

    def _begin(self, height_m: float = HEIGHT_M) -> None:
        super()._begin(height_m)

    def _info(self) -> dict[str, Any]:
        return super()._info() | {"coverage": self._coverage()}

    def _coverage(self) -> float:
        return float((map_from_above(self.situation.voxels) > 0).mean())

    def _way(self, action: FloatArray) -> tuple[FloatArray, float]:
        """Return the (K, 3) positions of the way to a waypoint, and the heading there."""
        here_m = self.situation.here_m
        target_m = np.clip(
            here_m[:2] + REACH_M * action, self.extent_m[0] + MARGIN_M, self.extent_m[1] - MARGIN_M
        )
        way_m = target_m - here_m[:2]
        if np.linalg.norm(way_m) < LEAST_STEP_M:
            _, _, z, w = self.pose.quat_xyzw
            return here_m[None], float(2 * np.arctan2(z, w))
        count = int(np.ceil(np.linalg.norm(way_m) / PATH_STEP_M)) + 1
        xy_m = here_m[:2] + np.linspace(0, 1, count)[:, None] * way_m
        path_m = np.column_stack((xy_m, self.surface_heights_m(xy_m) + HEIGHT_M))
        return path_m, float(np.arctan2(way_m[1], way_m[0]))
