"""Times of batches, of samples with a time budget, and of preparing Cycles for a moved camera."""

from __future__ import annotations

import time
from statistics import median
from typing import Any

import bpy

from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.worlds.demo_views import VIEWS, random_poses

STEADY_SAMPLES = 3
CAMERA_STEP_M = 0.15

BUDGET_VIEWS, QUICK_BUDGET_VIEWS = 20, 5
WARM_UP_VIEWS = 3
"""Views from which the backend learns what samples cost."""

LIGHT = ("Path Tracing", "Sample ", "Rendered", "Finish")
"""Words in Cycles' messages while it renders; all messages before are preparation."""


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


def time_by_budget(settings: Settings, say: Say, budgets_s: list[float]) -> list[list[float]]:
    """Return, by budget, the seconds of samples at random views."""
    count = QUICK_BUDGET_VIEWS if settings.quick else BUDGET_VIEWS
    found: list[list[float]] = []
    with simulation_of(world_config(settings)) as simulation:
        simulation.step_batch()
        observer = Observer(simulation)
        extent_m = simulation.info().stage_extent_m
        assert extent_m is not None
        poses = random_poses(WARM_UP_VIEWS + count, extent_m, observer.heights_m)
        for index, budget_s in enumerate(budgets_s):
            say(index / len(budgets_s), f"{count} random views in {budget_s:g} s each")
            # With the best preset, only the budget limits the samples.
            render = {"quality": "final", "time_budget_s": budget_s}
            took_s = [observer.sample(pose, render)[0] for pose in poses]
            found.append(took_s[WARM_UP_VIEWS:])
    return found


def preparation(settings: Settings, say: Say) -> dict[str, Any]:
    """Return seconds of preparation, and of whole samples, that differ in the camera's position.

    The preparation ends with Cycles' first message about rendering.
    """
    heard: list[tuple[float, str]] = []

    def listen(text: str, *_: Any) -> None:
        heard.append((time.perf_counter(), str(text)))

    prepare_s, all_s = [], []
    with simulation_of(world_config(settings)) as simulation:
        simulation.step_batch()
        observer = Observer(simulation)
        # After the backend has reset Blender.
        bpy.app.handlers.render_stats.append(listen)
        bpy.app.handlers.render_pre.append(lambda *_: listen("begins"))
        for run in range(settings.runs + 1):
            say(run / (settings.runs + 1), "moving the camera")
            heard.clear()
            pose = VIEWS[1].pose(observer.heights_m, CAMERA_STEP_M * run)
            seconds, _ = observer.sample(pose, {"quality": "standard"})
            prepare_s.append(_preparation_s(heard))
            all_s.append(seconds)
    return {"prepare_s": prepare_s[1:], "all_s": all_s[1:]}


def _preparation_s(heard: list[tuple[float, str]]) -> float:
    """Return the seconds from the beginning of a render to the first message about rendering."""
    if not heard:
        raise ValueError("Cycles sent no messages (render_stats)")
    for at_s, text in heard[1:]:
        if any(word in text for word in LIGHT):
            return at_s - heard[0][0]
    raise ValueError(f"none of Cycles' messages is about rendering: {[text for _, text in heard]}")
