"""What tests of things on the ground have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import bpy

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Sample


def samples(config: Mapping[str, Any], steps: Sequence[ModuleMetadata]) -> list[Sample]:
    """The samples of a simulation's first batch."""
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    return [simulation.step_sample(step) for step in steps]


def colors_of_added(config: Mapping[str, Any], step: ModuleMetadata) -> tuple[Any, int]:
    """A sample's colour image, and how many meshes Blender holds."""
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    sample = simulation.step_sample(step)
    return sample.frame("camera", "rgb").data, len(bpy.data.meshes)
