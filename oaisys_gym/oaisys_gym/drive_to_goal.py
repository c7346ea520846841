"""Driving over rough ground to a goal, by camera."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from oaisys_core.errors import OaisysError
from oaisys_core.types import FloatArray
from oaisys_gym.flight import START_SHARE, check_action
from oaisys_gym.terrain_env import Action, Observation, TerrainEnv
from oaisys_mapping.exploration.planner import level_pose

SPEED_M_S, TURN_RAD_S = 1.0, 0.6
"""Of the largest action."""

STEP_S = 1.0
SUBSTEPS = 8
"""Points of a step at which the ground is looked at."""

CAMERA_HEIGHT_M = 1.0
MAX_SLOPE_DEG = 35.0
"""Steepest ground, along its way, that the rover drives over."""

GOAL_RADIUS_M = 1.0
MARGIN_M = 0.5
"""The rover keeps so far from the stage's edge."""

LEAST_DISTANCE_M = 8.0
"""Of the goal from the start."""

PROGRESS_REWARD_PER_M, TIME_COST_PER_S, BLOCKED_COST, GOAL_REWARD = 1.0, 0.05, 0.5, 10.0

MAX_DRAWS = 1000
MAX_DISTANCE_M = 1e6


class DriveToGoal(TerrainEnv):
    """The action is a velocity, held for 1 s.

    It is (2,) float32 from -1 to 1: the speed ahead times 1 m/s, and the yaw rate, positive to the
    left, times 0.6 rad/s. A rover whose level camera is 1 m above ground and rocks follows the arc
    to where the ground rises or falls by more than 35 degrees, or to 0.5 m from the stage's edge;
    there it stops.

    An observation has, beside the images, ``goal``: (2,) float32, the distance of the goal in
    metres and its bearing in radians, positive to the left; and ``blocked``: (1,) float32, 1 if
    the last step was cut short.

    The reward is 1 for each metre nearer to the goal, less 0.05 for each second, less 0.5 if
    blocked, and 10 at the goal, within 1 m, where the episode ends (``terminated``). After 120 s
    it is ``truncated``. A goal may be out of reach. ``info`` has ``distance_m`` and ``blocked``.
    """

    def __init__(self, **options: Any) -> None:
        """See `oaisys_gym.terrain_env.TerrainEnv`."""
        super().__init__(**options)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        lowest, highest = np.array([0, -np.pi]), np.array([MAX_DISTANCE_M, np.pi])
        self._goal_space = spaces.Box(lowest.astype(np.float32), highest.astype(np.float32))
        self.observation_space = spaces.Dict(
            {
                **self.image_spaces,
                "goal": self._goal_space,
                "blocked": spaces.Box(0.0, 1.0, (1,), np.float32),
            }
        )

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for a second and look; see `gymnasium.Env.step`.

        Raises:
            InvalidInputError: The action is not two finite numbers.
        """
        self.require_reset()
        speed, turn = check_action(action, 2)
        before_m = self._distance_m()
        arc = unicycle_arc(self._place, speed * SPEED_M_S, turn * TURN_RAD_S, STEP_S, SUBSTEPS)
        free = self._free_steps(arc[:, :2])
        self._is_blocked = free < SUBSTEPS
        self._stand(arc[free])
        arrived = self._distance_m() <= GOAL_RADIUS_M
        reward = PROGRESS_REWARD_PER_M * (before_m - self._distance_m()) - TIME_COST_PER_S * STEP_S
        reward += GOAL_REWARD * arrived - BLOCKED_COST * self._is_blocked
        return self._observe(), float(reward), arrived, False, self._info()

    def _begin(self) -> None:
        start_m, self._goal_m = self._draw_places()
        self._is_blocked = False
        self._stand(np.array((*start_m, self.np_random.uniform(-np.pi, np.pi))))

    def _draw_places(self) -> tuple[FloatArray, FloatArray]:
        """Return the (2,) start and goal.

        Raises:
            OaisysError: The stage is too small for both.
        """
        middle_m, half_m = self.extent_m.mean(axis=0), np.ptp(self.extent_m, axis=0) / 2
        for _ in range(MAX_DRAWS):
            start_m, goal_m = middle_m + START_SHARE * half_m * self.np_random.uniform(
                -1, 1, (2, 2)
            )
            if np.linalg.norm(goal_m - start_m) >= LEAST_DISTANCE_M:
                return start_m, goal_m
        raise OaisysError(
            f"the stage of {np.ptp(self.extent_m, axis=0).tolist()} m is too small for a goal "
            f"{LEAST_DISTANCE_M:g} m from the start"
        )

    def _stand(self, place: FloatArray) -> None:
        """Put the rover at (3,) x, y and yaw, and look from there."""
        self._place = place
        height_m = float(self.surface_heights_m(place[None, :2])[0])
        pose = level_pose((*place[:2], height_m + CAMERA_HEIGHT_M), float(place[2]))
        self._look(pose, with_depth=False)

    def _free_steps(self, xy_m: FloatArray) -> int:
        """Return how many of the steps between (K + 1, 2) points the rover can drive, from 0."""
        heights_m = self.surface_heights_m(xy_m)
        steps_m = np.linalg.norm(np.diff(xy_m, axis=0), axis=1)
        steepest_m = np.tan(np.radians(MAX_SLOPE_DEG)) * steps_m
        low_m, high_m = self.extent_m[0] + MARGIN_M, self.extent_m[1] - MARGIN_M
        is_free = ((xy_m[1:] >= low_m) & (xy_m[1:] <= high_m)).all(axis=1)
        # NaN, where there is no ground, is not less than anything.
        is_free &= np.abs(np.diff(heights_m)) <= steepest_m
        return int(np.argmin(is_free)) if not is_free.all() else len(is_free)

    def _distance_m(self) -> float:
        return float(np.linalg.norm(self._goal_m - self._place[:2]))

    def _observe(self) -> Observation:
        way_m = self._goal_m - self._place[:2]
        bearing_rad = np.arctan2(way_m[1], way_m[0]) - self._place[2]
        bearing_rad = (bearing_rad + np.pi) % (2 * np.pi) - np.pi
        goal = np.array((self._distance_m(), bearing_rad), np.float32)
        return self._observed_images() | {
            "goal": np.clip(goal, self._goal_space.low, self._goal_space.high),
            "blocked": np.array([self._is_blocked], np.float32),
        }

    def _info(self) -> dict[str, Any]:
        distance_m = self._distance_m()
        return super()._info() | {"distance_m": distance_m, "blocked": self._is_blocked}


def unicycle_arc(
    place: FloatArray, speed_m_s: float, turn_rad_s: float, duration_s: float, steps: int
) -> FloatArray:
    """Return (steps + 1, 3) x, y and yaw of a unicycle with constant velocities, the first now.

    The chord of an arc of angle a is its length times sin(a/2) / (a/2), at the mean heading.
    """
    times_s = np.linspace(0, duration_s, steps + 1)
    half_rad = turn_rad_s * times_s / 2
    chords_m = speed_m_s * times_s * np.sinc(half_rad / np.pi)
    headings_rad = place[2] + half_rad
    return np.column_stack(
        (
            place[0] + chords_m * np.cos(headings_rad),
            place[1] + chords_m * np.sin(headings_rad),
            place[2] + 2 * half_rad,
        )
    )
