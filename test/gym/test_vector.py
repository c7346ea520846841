"""Several environments in processes of their own, each with its simulator."""

from __future__ import annotations

import gymnasium
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray
from waiting import wait_until

import oaisys_gym  # noqa: F401 - registers the environments


@pytest.mark.long
def test_two_environments_step_at_once() -> None:
    environments = gymnasium.make_vec(
        "oaisys/DriveToGoal-v0",
        num_envs=2,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
        world_seeds=(3,),
    )

    def begun(*seeds: int) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Return first depths and rewards of episodes."""
        observations, _ = environments.reset(seed=list(seeds))  # type: ignore[arg-type]
        _, rewards, *_ = environments.step(np.full((2, 2), 0.5, np.float32))
        return observations["depth"].copy(), rewards

    try:
        depths_m, rewards = begun(5, 6)
        assert depths_m.shape == (2, 48, 64)
        assert not np.array_equal(*depths_m)
        assert rewards[0] != rewards[1]
        exchanged_m, exchanged = begun(6, 5)
        np.testing.assert_array_equal(exchanged_m, depths_m[::-1])
        np.testing.assert_array_equal(exchanged, rewards[::-1])
        started = [
            process
            for process in psutil.Process().children(recursive=True)
            if "oaisys_grpc" in " ".join(process.cmdline())
        ]
        assert len(started) == 4  # two servers, each with its worker
    finally:
        environments.close()
    wait_until(lambda: not any(process.is_running() for process in started))
