"""What the tests of the ground beyond the stage have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import bpy
import numpy as np
from blender_jobs.backend import recorded_passes
from blender_jobs.examples import small
from numpy.typing import NDArray

from oaisys_core.config import SimulationConfig, load_config
from oaisys_core.render.blender import cycles
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose
from tools.bench.cycles_passes import FILTER_WIDTH_PX

Images = dict[str, NDArray[Any]]


def level_views(
    path: str,
    changes: Mapping[str, Any],
    places: Sequence[tuple[float, float, float]],
    height_m: float = 2.0,
) -> list[Images]:
    """Images of level views of an example's world, each with the depth that its colour is of.

    Args:
        path: The example.
        changes: Keys of its cameras and of its environment.
        places: (x, y, yaw) in shares of the stage's half edge and radians.
        height_m: Height of the views above the surface.
    """
    simulation = Simulation(_changed(load_config(Path(path)), changes))
    simulation.step_batch()
    bpy.context.scene.view_layers[0].use_pass_z = True
    found = []
    through_middle = mock.patch.object(cycles, "CYCLES_WIDTH_PX", FILTER_WIDTH_PX)
    with through_middle, recorded_passes() as seen:
        for place in places:
            pose = level_pose(simulation, place, height_m)
            sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
            images = {frame.modality: frame.data for frame in sample.frames}
            found.append(images | {"cycles": seen["Depth"].copy()})
    return found


def level_pose(simulation: Simulation, place: tuple[float, float, float], height_m: float) -> Pose:
    """Return the pose that looks level from a height above the surface."""
    x0, y0, x1, y1 = simulation.scene.ground.extent_m
    x, y = (x0 + x1 + place[0] * (x1 - x0)) / 2, (y0 + y1 + place[1] * (y1 - y0)) / 2
    z = float(simulation.query_height([(x, y, 0.0)]).surface_height_m[0]) + height_m
    yaw = place[2]
    return Pose((x, y, z), (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))))


def _changed(config: SimulationConfig, changes: Mapping[str, Any]) -> SimulationConfig:
    data = small(config).model_dump()
    data["sensors"]["pose_policy"] = "allow"
    data["sensors"]["cameras"] = [data["sensors"]["cameras"][0] | changes["camera"]]
    data["environment"].update(changes["environment"])
    return SimulationConfig.model_validate(data)
