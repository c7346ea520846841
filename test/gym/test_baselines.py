"""The baselines against random actions, paired: both begin each episode alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy import stats

import oaisys_gym  # noqa: F401 - registers the environments
from oaisys_gym.baselines import MostUnseenGround, PlannerPolicy, TurnToGoal
from oaisys_gym.drive_to_goal import unicycle_arc

SEEDS = range(100, 108)
"""None of them was looked at while the baselines were written."""


def returns(
    environment: gymnasium.Env[Any, Any], make_policy: Callable[[Any], Callable[[Any], Any]]
) -> np.ndarray:
    """Return the sum of rewards of an episode for each of `SEEDS`."""
    found = []
    for seed in SEEDS:
        observation, _ = environment.reset(seed=seed)
        environment.action_space.seed(seed)
        policy, total, ended = make_policy(environment), 0.0, False
        while not ended:
            observation, reward, terminated, truncated, _ = environment.step(policy(observation))
            total, ended = total + float(reward), terminated or truncated
        found.append(total)
    return np.array(found)


def random_policy(environment: gymnasium.Env[Any, Any]) -> Callable[[Any], Any]:
    return lambda _: environment.action_space.sample()


@pytest.mark.long
@pytest.mark.parametrize(
    ("task", "baseline", "steps"),
    [
        ("NextBestView", PlannerPolicy, 6),
        ("Coverage", MostUnseenGround, 40),
        ("DriveToGoal", TurnToGoal, 120),
    ],
)
def test_a_baseline_beats_random_actions(
    task: str, baseline: Callable[[Any], Callable[[Any], Any]], steps: int
) -> None:
    """By Wilcoxon's signed-rank test over eight drawn worlds: one chance in twenty to be luck."""
    environment = gymnasium.make(f"oaisys/{task}-v0", max_episode_steps=steps)
    better = returns(environment, baseline)
    worse = returns(environment, random_policy)
    environment.close()
    assert stats.wilcoxon(better, worse, alternative="greater").pvalue < 0.05, (better, worse)


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
