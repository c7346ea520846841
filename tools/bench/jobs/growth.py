"""Time and memory of a world: batch, samples, peak."""

from __future__ import annotations

import time
from statistics import median
from typing import Any

from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.machine import peak_memory_mb
from tools.bench.settings import Say, Settings, camera
from tools.bench.worlds.demo_views import VIEWS

CAMERA_STEP_M = 0.15
TURN_QUALITIES = ("geometry", "preview")
TURN_VIEWS = 5
"""Views per turn; their median counts."""


def point(
    settings: Settings, say: Say, changes: dict[str, Any], cameras: int, width_px: int
) -> dict[str, list[float]]:
    """Return seconds of a batch and of samples at two qualities, and the peak memory in MB.

    Args:
        settings: Of the run.
        say: Called with the progress.
        changes: To the demo's configuration.
        cameras: Number of cameras on the rig, side by side.
        width_px: Of each image; the aspect ratio is 4:3.
    """
    sized = {**changes, "sensors": {"cameras": [_camera(i, width_px) for i in range(cameras)]}}
    config = world_config(settings, sized)
    with simulation_of(config) as simulation:
        say(0.0, "batch")
        started_s = time.perf_counter()
        simulation.step_batch()
        build_s = time.perf_counter() - started_s
        observer = Observer(simulation)
        poses = [VIEWS[1].pose(observer.heights_m, CAMERA_STEP_M * i) for i in range(settings.runs)]
        found = {"build": [build_s]}
        for share, quality in ((0.4, "geometry"), (0.6, "preview")):
            say(share, quality)
            found[quality] = observer.seconds(poses, quality)
    return {**found, "memory": [peak_memory_mb()]}


def in_turns(
    settings: Settings, say: Say, worlds: list[dict[str, Any]]
) -> list[dict[str, list[float]]]:
    """Return, for each turn and quality, the seconds of a sample of each world.

    The worlds take turns, because the machine's speed drifts by more than their difference.

    Args:
        settings: Of the run.
        say: Called with the progress.
        worlds: Changes to the demo's configuration.
    """
    turns = []
    for turn in range(settings.runs):
        say(turn / settings.runs, f"turn {turn + 1}")
        # Every other turn is reversed, so that a steady drift cancels out.
        order = list(enumerate(worlds))[:: 1 if turn % 2 == 0 else -1]
        took = {index: _steady_s(settings, world) for index, world in order}
        turns.append({q: [took[index][q] for index in range(len(worlds))] for q in TURN_QUALITIES})
    return turns


def _steady_s(settings: Settings, changes: dict[str, Any]) -> dict[str, float]:
    """Return, by quality, the median seconds of a sample of a world."""
    with simulation_of(world_config(settings, changes)) as simulation:
        simulation.step_batch()
        observer = Observer(simulation)
        poses = [VIEWS[1].pose(observer.heights_m, CAMERA_STEP_M * i) for i in range(TURN_VIEWS)]
        return {quality: median(observer.seconds(poses, quality)) for quality in TURN_QUALITIES}


def _camera(index: int, width_px: int) -> dict[str, Any]:
    """Return the configuration of one of the cameras."""
    (one,) = camera(width_px, width_px * 3 // 4)["sensors"]["cameras"]
    return {
        **one,
        "name": f"camera_{index}",
        "mount_position_m": [0.0, -0.2 * index, 0.0],
        "modalities": [RGB, DEPTH, SEMANTIC_0, INSTANCE],
    }
