"""What Cycles does before it renders, when nothing but the camera has moved."""

from __future__ import annotations

import time
from typing import Any

import bpy

from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.views import VIEWS

ASIDE_M = 0.15
LIGHT = ("Path Tracing", "Sample ", "Rendered", "Finish")
"""In Cycles' own words, what is rendering; all that it says before is preparation."""


def shares(settings: Settings, say: Say) -> dict[str, Any]:
    """Return, for samples that differ by the camera's place, seconds to the first light and in all.

    Cycles tells what it does as it goes; the first word of rendering ends its preparations.
    """
    heard: list[tuple[float, str]] = []

    def listen(text: str, *_: Any) -> None:
        heard.append((time.perf_counter(), str(text)))

    prepare_s, all_s = [], []
    with simulation_of(world_config(settings)) as simulation:
        simulation.step_batch()
        observer = Observer(simulation)
        # Not earlier: the backend resets Blender as it begins.
        bpy.app.handlers.render_stats.append(listen)
        bpy.app.handlers.render_pre.append(lambda *_: listen("begins"))
        for run in range(settings.runs + 1):
            say(run / (settings.runs + 1), "moving the camera")
            heard.clear()
            pose = VIEWS[1].pose(observer.heights_m, ASIDE_M * run)
            seconds, _ = observer.sample(pose, {"quality": "standard"})
            prepare_s.append(_preparation_s(heard))
            all_s.append(seconds)
    return {"prepare_s": prepare_s[1:], "all_s": all_s[1:]}


def _preparation_s(heard: list[tuple[float, str]]) -> float:
    """Return the seconds from the beginning of a render to the first word of rendering."""
    if not heard:
        raise ValueError("Cycles said nothing: no render_stats arrived")
    for at_s, text in heard[1:]:
        if any(word in text for word in LIGHT):
            return at_s - heard[0][0]
    raise ValueError(f"Cycles never said that it rendered: {[text for _, text in heard]}")
