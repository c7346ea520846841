"""A simulation in this process, and the times of its samples."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

# Must come before anything that loads Open3D, see oaisys_core.backend.raycast.triangles.
import bpy  # noqa: F401

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.types import FloatArray, ModuleMetadata, Pose, Sample, merged
from tools.bench.settings import CONFIG, Settings, demo_world
from tools.bench.views import NOON


def world_config(settings: Settings, changes: Mapping[str, Any] | None = None) -> SimulationConfig:
    """Return the demo's configuration at the run's image size, with changes on top."""
    return config_from_mapping(merged(demo_world(settings), changes or {}), CONFIG.parent)


@contextmanager
def simulation_of(config: SimulationConfig) -> Iterator[Simulation]:
    """Yield a simulation and close it afterwards."""
    simulation = Simulation(config)
    try:
        yield simulation
    finally:
        simulation.close()


class Observer:
    """Steps samples of a simulation and times them."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def heights_m(self, points_m: Sequence[tuple[float, float, float]]) -> FloatArray:
        """Return the surface's heights under points."""
        return self._simulation.query_height(points_m).surface_height_m

    def sample(
        self,
        pose: Pose,
        render: Mapping[str, Any],
        environment: Mapping[str, Any] | None = None,
        modalities: Sequence[str] = (),
    ) -> tuple[float, Sample]:
        """Return the seconds that a sample took, and the sample."""
        metadata = ModuleMetadata(
            sensor={"pose": pose}, environment={**NOON, **(environment or {})}, render=render
        )
        started_s = time.perf_counter()
        sample = self._simulation.step_sample(metadata, modalities=modalities)
        return time.perf_counter() - started_s, sample

    def seconds(self, poses: Sequence[Pose], quality: str) -> list[float]:
        """Return the seconds of a sample at each pose, after a warm-up."""
        self.sample(poses[-1], {"quality": quality})
        return [self.sample(pose, {"quality": quality})[0] for pose in poses]
