"""Times and processor time of samples in a process that may use some of the cores only."""

from __future__ import annotations

import os
import time
from typing import Any

import bpy

from tools.bench.calibration import SpeedCalibration
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.worlds.demo_views import VIEWS

QUALITIES = ("geometry", "preview", "standard")
ROUNDS, QUICK_VIEWS = 2, 2
SAMPLED_VIEWS = tuple(view for view in VIEWS if not view.environment)
"""Those of one light, because a change of light takes seconds."""
FEW, MANY = 1, 9
"""Samples per pixel of the calibration; what the difference takes is sampling alone."""


def time_samples(settings: Settings, say: Say, count: int) -> dict[str, Any]:
    """Return seconds and processor seconds of samples, by quality, and of pure sampling.

    Args:
        settings: Of the run.
        say: Called with the progress.
        count: Number of cores that this process may use, as its parent has arranged.

    Returns:
        By quality ``s`` and ``cpu_s`` (user and system time of all threads); ``sampling_s``, the
        seconds that `MANY` less `FEW` samples per pixel of the frozen scene take.
    """
    usable = len(os.sched_getaffinity(0))
    if usable != count:
        raise ValueError(f"received {usable} usable cores, expected {count}")
    found: dict[str, Any] = {}
    with (
        SpeedCalibration(settings.out / "logs" / "calibration.log") as calibration,
        simulation_of(world_config(settings)) as simulation,
    ):
        bpy.context.scene.render.threads_mode = "FIXED"
        bpy.context.scene.render.threads = count
        say(0.0, "batch")
        simulation.step_batch()
        observer = Observer(simulation)
        chosen = SAMPLED_VIEWS[:QUICK_VIEWS] if settings.quick else SAMPLED_VIEWS
        views = [view.with_pose(observer.heights_m) for view in chosen]
        sampling_s = [_sampling_s(calibration)]
        for index, quality in enumerate(QUALITIES):
            say((1 + index) / (1 + len(QUALITIES)), quality)
            found[quality] = {"s": [], "cpu_s": []}
            observer.view(views[-1], {"quality": quality})
            for _ in range(ROUNDS):
                for view in views:
                    began_cpu_s = time.process_time()
                    took_s, _ = observer.view(view, {"quality": quality})
                    found[quality]["cpu_s"].append(time.process_time() - began_cpu_s)
                    found[quality]["s"].append(took_s)
            sampling_s.append(_sampling_s(calibration))
    return {**found, "sampling_s": sampling_s}


def _sampling_s(calibration: SpeedCalibration) -> float:
    return calibration.seconds(MANY) - calibration.seconds(FEW)
