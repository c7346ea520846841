"""What one world costs to build, to sample and to hold."""

from __future__ import annotations

import time
from typing import Any

from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0
from tools.bench.jobs.memory import peak_memory_mb
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.views import VIEWS

ASIDE_M = 0.15
CAMERA_FX_SHARE = 541.14 / 640


def point(
    settings: Settings, say: Say, changes: dict[str, Any], cameras: int, width_px: int
) -> dict[str, list[float]]:
    """Return seconds of a batch and of samples at two qualities, and the peak memory in MB.

    Args:
        settings: Of the run.
        say: Told how far it is.
        changes: Of the demo's configuration.
        cameras: On the rig, side by side.
        width_px: Of each image, 4:3.
    """
    sized = {**changes, "sensors": {"cameras": [_camera(i, width_px) for i in range(cameras)]}}
    config = world_config(settings, sized)
    with simulation_of(config) as simulation:
        say(0.0, "batch")
        started_s = time.perf_counter()
        simulation.step_batch()
        build_s = time.perf_counter() - started_s
        observer = Observer(simulation)
        poses = [VIEWS[1].pose(observer.heights_m, ASIDE_M * i) for i in range(settings.runs)]
        found = {"build": [build_s]}
        for share, quality in ((0.4, "geometry"), (0.6, "preview")):
            say(share, quality)
            found[quality] = observer.seconds(poses, quality)
    return {**found, "memory": [peak_memory_mb()]}


def _camera(index: int, width_px: int) -> dict[str, Any]:
    """Return a camera of a row across the rig."""
    return {
        "name": f"camera_{index}",
        "width_px": width_px,
        "height_px": width_px * 3 // 4,
        "fx_px": CAMERA_FX_SHARE * width_px,
        "fy_px": CAMERA_FX_SHARE * width_px,
        "mount_position_m": [0.0, -0.2 * index, 0.0],
        "modalities": [RGB, DEPTH, SEMANTIC_0, INSTANCE],
    }
