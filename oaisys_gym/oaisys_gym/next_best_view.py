"""Choosing the next view of a flying vehicle, where it is known that there is room for it."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from oaisys_core.types import FloatArray, Pose
from oaisys_gym.flight import (
    RADIUS_M,
    SPEED_M_S,
    SURFACE_REWARD_PER_M2,
    TIME_COST_PER_S,
    VIEW_S,
    FlightEnv,
    check_action,
    path_length_m,
    unscale_pose,
)
from oaisys_gym.terrain_env import Action, Observation
from oaisys_mapping.exploration.planner import Situation, level_pose

CLEARANCE_M = 1.5
CLEARANCE_COST_PER_M = 0.2
"""A view from nearer than `CLEARANCE_M` to what is not known to be free costs this per metre."""

REFUSED_COST = 0.5
"""Cost of a view to which no way is known to be free; the vehicle stays."""


class NextBestView(FlightEnv):
    """The action is the pose of the next view.

    It is (4,) float32 from -1 to 1, as ``pose`` in `FlightEnv`: x, y and z in the box, and the
    heading over pi. The vehicle flies to the place nearest to it that is known to be free.

    The reward is 0.05 for each m² of surface that is observed for the first time, less 0.02 for
    each second of flight (2 m/s, 1 s for a view), less 0.2 for each metre of clearance below 1.5 m.
    ``info`` has ``surface_m2``, ``flown_m``, ``refused`` and ``world_seed``. An episode ends after
    30 views (``truncated``).
    """

    def __init__(self, **options: Any) -> None:
        """See `oaisys_gym.terrain_env.TerrainEnv`."""
        super().__init__(**options)
        self.action_space = spaces.Box(-1.0, 1.0, (4,), np.float32)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Fly to a pose and look from there; see `gymnasium.Env.step`.

        Raises:
            InvalidInputError: The action is not four finite numbers.
        """
        self.require_reset()
        found = pose_and_path(check_action(action, 4), self.situation)
        if found is None:
            cost = REFUSED_COST + TIME_COST_PER_S * VIEW_S
            return self._observe(), -cost, False, False, self._info() | {"refused": True}
        pose, path_m = found
        length_m = path_length_m(path_m)
        before_m2 = self._surface_m2()
        self._flown_m += length_m
        self._view(pose)
        reward = SURFACE_REWARD_PER_M2 * (self._surface_m2() - before_m2)
        reward -= TIME_COST_PER_S * (length_m / SPEED_M_S + VIEW_S)
        reward -= CLEARANCE_COST_PER_M * max(0.0, CLEARANCE_M - self._clearance_m())
        return self._observe(), float(reward), False, False, self._info() | {"refused": False}

    def _clearance_m(self) -> float:
        cells, inside = self.situation.voxels.indices(self.situation.here_m[None])
        return float(self.situation.clearance_m[tuple(cells[0])]) if inside[0] else RADIUS_M


def pose_and_path(action: FloatArray, situation: Situation) -> tuple[Pose, FloatArray] | None:
    """Return the pose that an action leads to, and the (K, 3) way there; None if there is none.

    It is at the voxel known to be free that is nearest to the action's position.
    """
    wanted = unscale_pose(action.astype(np.float32), situation.voxels.bounds)
    if not len(situation.safe_cells):
        return None
    places_m = situation.voxels.centers_m(situation.safe_cells)
    away_m = np.linalg.norm(places_m - wanted.position_m, axis=1)
    place_m = places_m[away_m.argmin()]
    path_m = situation.path_m(place_m)
    return None if path_m is None else (level_pose(place_m, float(action[3]) * np.pi), path_m)
