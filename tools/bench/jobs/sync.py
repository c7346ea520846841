"""Time that Cycles takes before its first sample when only the camera has moved."""

from __future__ import annotations

import time
from typing import Any

import bpy

from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.views import VIEWS

CAMERA_STEP_M = 0.15
LIGHT = ("Path Tracing", "Sample ", "Rendered", "Finish")
"""Words in Cycles' messages while it renders; all messages before are preparation."""


def shares(settings: Settings, say: Say) -> dict[str, Any]:
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
