"""Small worlds whose layers bring grass or stones, and what these are not part of."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_looking_at
from oaisys_core.scene import Placement
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, ObjectQuery


def covered_world(
    *layers: dict[str, Any],
    stage: dict[str, Any] | None = None,
    materials: dict[str, Any] | None = None,
    assets: dict[str, Any] | None = None,
) -> Simulation:
    """Return a world of some layers, in its first batch; further keys of its sections."""
    config = {
        "seed": 4,
        "backend": "analytic",
        "stage": {"preset": "mounds", "extent_m": 16.0, "resolution_px": 65, **(stage or {})},
        "materials": {
            "layers": layers,
            "texture_size_px": 128,
            "mask": {"size_px": 256},
            **(materials or {}),
        },
        "assets": {"rocks": [], **(assets or {})},
        "sensors": {
            "cameras": [
                {
                    "width_px": 64,
                    "height_px": 48,
                    "fx_px": 50,
                    "fy_px": 50,
                    "modalities": ["depth", "semantic_0", "instance"],
                }
            ]
        },
    }
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    return simulation


def cover(simulation: Simulation, *, on_stage: bool = False) -> list[Placement]:
    """Return what layers bring; ``on_stage``: not on the land around it."""
    placements = simulation.scene.placements
    return [each for each in placements if each.is_ground_cover and not (on_stage and each.on_land)]


def poses(placements: list[Placement]) -> NDArray[np.float64]:
    """Return the (N, 4, 4) poses of all instances."""
    return np.concatenate([each.T_map_object for each in placements])


def view(simulation: Simulation, height_m: float, ahead_m: float) -> dict[str, Any]:
    """Return the images of a camera above the middle that looks at the ground ahead."""
    z_m = float(simulation.query_height([(0, 0, 0)]).ground_height_m[0])
    pose = pose_looking_at((0, 0, z_m + height_m), (ahead_m, 0, z_m))
    sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
    return {each.modality: each.data for each in sample.frames}


def assert_belongs_to_the_ground(covered: Simulation, bare: Simulation) -> None:
    """Check that a cover is no object, no height and no part of the ground truth."""
    assert covered.list_objects(ObjectQuery()).total == 0
    feet = poses(cover(covered, on_stage=True))[:50, :3, 3]
    found = covered.query_height(feet)
    np.testing.assert_allclose(found.surface_height_m, found.ground_height_m, atol=1e-9)
    one, other = covered.ground_truth_mesh(), bare.ground_truth_mesh()
    np.testing.assert_array_equal(one.triangles, other.triangles)
