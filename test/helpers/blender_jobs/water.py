"""What tests of water and ice have done in Blender's own process, see `blender_process`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.types import RGB, ModuleMetadata, Pose

Pictures = dict[tuple[int, float, str], NDArray[np.uint8]]


def pictures(
    config: Mapping[str, Any],
    poses: Sequence[Pose],
    sun_elevations_deg: Sequence[float],
    qualities: Sequence[str],
) -> Pictures:
    """Pictures of a world by the pose's place, the sun's elevation and the quality."""
    found: Pictures = {}
    with closing(Simulation(config_from_mapping(config))) as simulation:
        simulation.step_batch()
        for elevation_deg in sun_elevations_deg:
            for index, pose in enumerate(poses):
                for quality in qualities:
                    metadata = ModuleMetadata(
                        sensor={"pose": pose},
                        environment={"sun_elevation_deg": elevation_deg},
                        render={"quality": quality},
                    )
                    sample = simulation.step_sample(metadata)
                    frame = next(each for each in sample.frames if each.modality == RGB)
                    found[index, elevation_deg, quality] = frame.data
    return found
