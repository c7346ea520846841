"""A policy of `oaisys/NextBestView-v0` as a planner of `oaisys explore`."""

from __future__ import annotations

from abc import abstractmethod

from oaisys_core.types import Pose
from oaisys_gym.flight import check_action, flight_observation
from oaisys_gym.next_best_view import pose_and_path
from oaisys_gym.terrain_env import Action, Observation
from oaisys_mapping.exploration.planner import Planner, Situation


class PolicyPlanner(Planner):
    """Has a policy choose the views of an exploration: subclass it and write `act`.

    The policy is one that was trained with ``modalities=()``: a planner is given the map, not
    images. Name the class under the entry point group ``oaisys.planners``.
    """

    @abstractmethod
    def act(self, observation: Observation) -> Action:
        """Return the (4,) action for ``map`` and ``pose``, as in `oaisys_gym.flight.FlightEnv`."""

    def next_pose(self, situation: Situation) -> Pose | None:
        """Return where the policy's action leads to; None if there is no way."""
        action = check_action(self.act(flight_observation(situation)), 4)
        found = pose_and_path(action, situation)
        return None if found is None else found[0]
