"""A simulation in this process, and the times of its samples."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

# Must come before anything that loads Open3D, see oaisys_core.private.open3d_import.
import bpy  # noqa: F401

import _cycles  # isort: skip

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.errors import BackendUnavailableError
from oaisys_core.simulation import Simulation
from oaisys_core.types import FloatArray, ModuleMetadata, Pose, Sample, merge
from tools.bench.settings import Settings
from tools.bench.worlds.demo_views import NOON, PosedView
from tools.bench.worlds.panel import DEMO, world_file, world_mapping


def world_config(
    settings: Settings, changes: Mapping[str, Any] | None = None, world: str = DEMO
) -> SimulationConfig:
    """Return a world's configuration at the run's image size, with changes on top."""
    mapping = merge(world_mapping(settings, world), changes or {})
    return config_from_mapping(mapping, world_file(world).parent)


@contextmanager
def simulation_of(config: SimulationConfig) -> Iterator[Simulation]:
    """Yield a simulation and close it afterwards.

    Raises:
        BackendUnavailableError: The configured device is a GPU that this machine does not have.
    """
    simulation = Simulation(config)
    try:
        if config.backend == "blender":
            _check_device(config.render.device)
        yield simulation
    finally:
        simulation.close()


def _check_device(wanted: str) -> None:
    """Refuse a GPU that is missing; the simulation would render on the CPU with a warning."""
    if wanted in ("auto", "cpu"):
        return
    found = [kind for _, kind, *_ in _cycles.available_devices(wanted.upper())]
    if wanted.upper() not in found:
        raise BackendUnavailableError(f"--device: received {wanted}, Cycles finds only {found}")


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
        view = PosedView("", pose, {**NOON, **(environment or {})})
        return self.view(view, render, modalities)

    def view(
        self, view: PosedView, render: Mapping[str, Any], modalities: Sequence[str] = ()
    ) -> tuple[float, Sample]:
        """Return the seconds that a sample of a view took in its own light, and the sample."""
        metadata = ModuleMetadata(
            sensor={"pose": view.pose},
            environment=view.environment,
            render={**render, **view.render},
        )
        started_s = time.perf_counter()
        sample = self._simulation.step_sample(metadata, modalities=modalities)
        return time.perf_counter() - started_s, sample

    def seconds(self, poses: Sequence[Pose], quality: str) -> list[float]:
        """Return the seconds of a sample at each pose, after a warm-up."""
        self.sample(poses[-1], {"quality": quality})
        return [self.sample(pose, {"quality": quality})[0] for pose in poses]
