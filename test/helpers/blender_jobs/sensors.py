"""What tests of cameras have done in Blender's own process."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from synthetic_worlds import settings

from oaisys_core.config import config_from_mapping
from oaisys_core.render.base import Backend
from oaisys_core.render.blender import BlenderBackend
from oaisys_core.scene import PlacedCamera, PlacedLidar, Scene
from oaisys_core.sensing.faults import CaptureId
from oaisys_core.sensing.view_transforms import BASE_EXPOSURE_EV
from oaisys_core.simulation import Simulation
from oaisys_core.types import Frame, LidarScan, Progress


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def views(cases: Sequence[tuple[Scene, PlacedCamera]], samples: int = 1) -> list[tuple[Frame, ...]]:
    """Frames of one camera in each world, which is built once for cases that share it in turn."""
    backend = BlenderBackend()
    frames = []
    built: Scene | None = None
    for scene, camera in cases:
        if scene is not built:
            backend.build(scene, ignore)
            built = scene
        linear = settings(samples, exposure_ev=-BASE_EXPOSURE_EV)
        wanted = replace(linear, view_transform="raw")
        frames.append(backend.render_all([camera], wanted, ignore))
    return frames


def samples(config: Mapping[str, Any], count: int) -> list[list[tuple[str, str, Any]]]:
    """Sensor, modality and pixels of each image of the first samples of a world."""
    simulation = Simulation(config_from_mapping(config))
    try:
        simulation.step_batch()
        taken = [simulation.step_sample() for _ in range(count)]
    finally:
        simulation.close()
    return [[(f.sensor, f.modality, f.data) for f in sample.frames] for sample in taken]


def scans(
    scene: Scene, lidars: Sequence[PlacedLidar], cameras: Sequence[PlacedCamera]
) -> tuple[list[LidarScan], tuple[Frame, ...], LidarScan, float]:
    """Scans and images of a world; the last scan again, and the processor time it then takes."""
    backend: Backend = BlenderBackend()
    backend.build(scene, ignore)
    found = [backend.scan(lidar, CaptureId(1, 1, lidar.name)) for lidar in lidars]
    frames = backend.render_all(cameras, settings(), ignore)
    seconds = []
    for _ in range(5):
        before_s = time.process_time()
        again = backend.scan(lidars[-1], CaptureId(1, 1, lidars[-1].name))
        seconds.append(time.process_time() - before_s)
    return found, frames, again, min(seconds)
