"""A policy explores a world as a planner does."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

import oaisys_gym  # noqa: F401 - registers the environments
from oaisys_gym.policy_planner import PolicyPlanner
from oaisys_gym.simulator import EpisodeSimulator


class Fixed(PolicyPlanner):
    """Wants the middle of the box, looking along -y, whatever it sees."""

    name = "fixed"

    def act(self, observation: dict[str, Any]) -> np.ndarray:
        self.seen = observation
        return np.array((0.0, 0.0, 0.5, -0.5), np.float32)


def test_a_policy_as_a_planner_goes_where_the_environment_would(own: EpisodeSimulator) -> None:
    environment = gymnasium.make(
        "oaisys/NextBestView-v0", address=own.address, modalities=(), world_seeds=(3,)
    )
    observation, _ = environment.reset(seed=4)
    inner: Any = environment.unwrapped
    planner = Fixed()
    pose = planner.next_pose(inner.situation)
    assert pose is not None
    for name in ("map", "pose"):
        np.testing.assert_array_equal(planner.seen[name], observation[name])
    environment.step(planner.act(observation))
    assert inner.pose == pose
    np.testing.assert_allclose(pose.quat_xyzw, (0, 0, -np.sqrt(0.5), np.sqrt(0.5)), atol=1e-6)
    environment.close()
