"""The baselines against random actions, paired: both begin each episode alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import stats

import oaisys_gym  # noqa: F401 - registers the environments
from oaisys_gym.baselines import BestWaypoint, PlannerPolicy, TurnToGoal
from oaisys_gym.drive_to_goal import unicycle_arc
from oaisys_gym.simulator import EpisodeSimulator

SEEDS = range(200, 205)
"""None of them was looked at while the baselines were written."""


def episode(environment: gymnasium.Env[Any, Any], seed: int, policy: Callable[[Any], Any]) -> float:
    """Return the sum of an episode's rewards."""
    observation, _ = environment.reset(seed=seed)
    total, ended = 0.0, False
    while not ended:
        observation, reward, terminated, truncated, _ = environment.step(policy(observation))
        total, ended = total + float(reward), terminated or truncated
    return total


@pytest.mark.parametrize(
    ("task", "baseline", "steps"),
    [
        pytest.param("NextBestView", PlannerPolicy, 5, marks=pytest.mark.long),
        pytest.param("Coverage", BestWaypoint, 40, marks=pytest.mark.soak),
        pytest.param("DriveToGoal", TurnToGoal, 60, marks=pytest.mark.soak),
    ],
)
def test_a_baseline_beats_random_actions(
    task: str,
    baseline: Callable[[Any], Callable[[Any], Any]],
    steps: int,
    own: EpisodeSimulator,
) -> None:
    """By Wilcoxon's signed-rank test over five drawn worlds: at most one chance in twenty."""
    environment = gymnasium.make(f"oaisys/{task}-v0", address=own.address, max_episode_steps=steps)
    pairs = []
    for seed in SEEDS:
        environment.action_space.seed(seed)
        by_chance = episode(environment, seed, lambda _: environment.action_space.sample())
        pairs.append((episode(environment, seed, baseline(environment)), by_chance))
    better, worse = np.array(pairs).T
    assert stats.wilcoxon(better, worse, alternative="greater").pvalue < 0.05, pairs


def test_an_arc_is_what_many_small_steps_add_up_to() -> None:
    place = np.array((1.0, -2.0, 0.7))
    speed_m_s, turn_rad_s, count = 0.8, -0.6, 100_000
    yaws_rad = 0.7 + turn_rad_s * (np.arange(count) + 0.5) / count
    steps_m = speed_m_s / count * np.column_stack((np.cos(yaws_rad), np.sin(yaws_rad)))
    arc = unicycle_arc(place, speed_m_s, turn_rad_s, 1.0, 8)
    np.testing.assert_allclose(arc[-1, :2], place[:2] + steps_m.sum(axis=0), atol=1e-8)
    np.testing.assert_allclose(arc[-1, 2], 0.1)
    np.testing.assert_allclose(arc[0], place)
    straight = unicycle_arc(place, speed_m_s, 0.0, 1.0, 8)
    np.testing.assert_allclose(np.hypot(*(straight[-1] - place)[:2]), speed_m_s)
