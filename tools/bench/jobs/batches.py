"""Times of batches, and of the first sample after each."""

from __future__ import annotations

import time
from statistics import median
from typing import Any

from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.views import VIEWS

STEADY_SAMPLES = 3
CAMERA_STEP_M = 0.15


def batches(settings: Settings, say: Say, changes: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return seconds of a process's first batch, of a second one, and of one on the same stage.

    Each comes with the extra time of its first sample over a steady one.
    """
    found = {}
    with simulation_of(world_config(settings, changes)) as simulation:
        observer = Observer(simulation)
        steps: dict[str, dict[str, Any]] = {
            "first": {"seed": 11},
            "second": {"seed": 12},
            "reused": {"seed": 13, "reuse_stage": True},
        }
        for index, (name, arguments) in enumerate(steps.items()):
            say(index / len(steps), f"{name} batch")
            started_s = time.perf_counter()
            simulation.step_batch(**arguments)
            batch_s = time.perf_counter() - started_s
            poses = [
                VIEWS[1].pose(observer.heights_m, CAMERA_STEP_M * i) for i in range(STEADY_SAMPLES)
            ]
            first_s, _ = observer.sample(poses[-1], {"quality": "standard"})
            steady = [observer.sample(pose, {"quality": "standard"})[0] for pose in poses]
            extra_s = first_s - median(steady)
            found[name] = {"batch_s": batch_s, "first_sample_extra_s": extra_s}
    return found
