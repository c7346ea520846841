"""What the test of the reference passes has done in Blender's own process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_at, pose_looking_down, pose_to_matrix
from oaisys_core.scene import PlacedCamera
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, PinholeIntrinsics, Pose
from tools.bench.cycles_passes import reference_images

Images = dict[str, NDArray[Any]]


def both_ways(
    config: Mapping[str, Any], preset: str, modalities: Sequence[str]
) -> list[tuple[Images, Images]]:
    """Images of views of a preset, as samples give them and as Cycles' passes show them."""
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch(ModuleMetadata(custom={"stage": {"preset": preset}}))
    height_m = float(simulation.query_height([(0.0, 0.0, 0.0)]).surface_height_m[0])
    found = []
    for pose in poses(height_m):
        metadata = ModuleMetadata(sensor={"pose": pose})
        sample = simulation.step_sample(metadata, modalities=modalities)
        fast = {frame.modality: frame.data for frame in sample.frames}
        intrinsics: PinholeIntrinsics = sample.frames[0].intrinsics
        T_map_camera = pose_to_matrix(pose) @ T_LINK_OPTICAL
        camera = PlacedCamera("camera", intrinsics, T_map_camera, tuple(modalities))
        found.append((fast, reference_images(simulation.scene, camera, modalities)))
    return found


def poses(height_m: float) -> list[Pose]:
    """From above, askew, and towards the horizon."""
    return [
        pose_looking_down(0.0, 0.0, height_m + 6.0, 0.3),
        pose_looking_at((-4.0, -3.0, height_m + 5.0), (1.0, 0.5, height_m), (0.1, 0.2, 1.0)),
        pose_looking_at((-2.0, 3.0, height_m + 6.0), (14.0, 6.0, height_m + 1.0)),
    ]
