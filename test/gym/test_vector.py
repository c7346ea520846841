"""Several environments in processes of their own, each with its simulator."""

from __future__ import annotations

import gymnasium
import numpy as np
import psutil
import pytest
from waiting import wait_until

import oaisys_gym  # noqa: F401 - registers the environments


@pytest.mark.long
def test_three_environments_step_at_once() -> None:
    environments = gymnasium.make_vec(
        "oaisys/DriveToGoal-v0",
        num_envs=3,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
        world_seeds=(3,),
    )
    try:
        observations, _ = environments.reset(seed=[5, 6, 5])  # type: ignore[arg-type]
        depths_m = observations["depth"]
        assert depths_m.shape == (3, 48, 64)
        np.testing.assert_array_equal(depths_m[0], depths_m[2])
        assert not np.array_equal(depths_m[0], depths_m[1])
        _, rewards, *_ = environments.step(np.full((3, 2), 0.5, np.float32))
        assert rewards[0] == rewards[2] != rewards[1]
        started = [
            process
            for process in psutil.Process().children(recursive=True)
            if "oaisys_grpc" in " ".join(process.cmdline())
        ]
        assert len(started) == 6  # three servers, each with its worker
    finally:
        environments.close()
    wait_until(lambda: not any(process.is_running() for process in started))
