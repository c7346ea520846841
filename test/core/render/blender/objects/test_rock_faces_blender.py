"""Broken rock in walls in Blender: it has the colour of the ground's rock."""

from __future__ import annotations

from contextlib import closing

import numpy as np

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import FloatArray, ModuleMetadata

WORLD = {
    "seed": 4,
    "stage": {
        "preset": "mesa",
        "extent_m": 60.0,
        "resolution_px": 257,
        "surroundings": "plain",
    },
    "materials": {
        "texture_size_px": 256,
        "layers": [
            {
                "texture": "bedrock",
                "label": "rock",
                "semantic_id": 3,
                "color": {"hue_deg": [40, 40], "saturation": [2.5, 2.5]},
            },
        ],
    },
    "assets": {"rocks": []},
    "sensors": {
        "cameras": [
            {
                "width_px": 64,
                "height_px": 48,
                "fx_px": 50,
                "fy_px": 50,
                "modalities": ["rgb", "albedo", "depth"],
            }
        ]
    },
}


def albedos(quality: str) -> tuple[FloatArray, FloatArray]:
    """Return the (48, 64, 3) linear albedo and (48, 64) depth of a view of a wall."""
    with closing(Simulation(config_from_mapping(WORLD))) as simulation:
        simulation.step_batch()
        T = np.concatenate(
            [each.T_map_object for each in simulation.scene.placements if each.is_rock_face]
        )
        T = T[np.argmax(np.linalg.norm(T[:, :3, 0], axis=1))]
        eye_m = T[:3, 3] + 2.0 * T[:3, 2]
        sensor = {
            "pose": pose_looking_at(tuple(eye_m), tuple(T[:3, 3])),
            "pose_policy": "allow",
        }
        sample = simulation.step_sample(ModuleMetadata(sensor=sensor, render={"quality": quality}))
        camera = sample.frames[0].sensor
        depth_m = np.asarray(sample.frame(camera, "depth").data, np.float64)
        return np.asarray(sample.frame(camera, "albedo").data, np.float64), depth_m


def test_cycles_and_the_draft_show_the_same_rock() -> None:
    rendered, depth_m = albedos("standard")
    drawn, same_m = albedos("draft")
    np.testing.assert_array_equal(depth_m, same_m)
    seen = np.isfinite(depth_m)
    one, other = rendered[seen], drawn[seen]
    assert one.mean() > 0.02
    # Orange rock: neither grey nor the colour of another thing.
    assert one[:, 0].mean() > 1.3 * one[:, 2].mean()
    np.testing.assert_allclose(one.mean(axis=0), other.mean(axis=0), rtol=0.06)
    assert np.corrcoef(one.mean(axis=1), other.mean(axis=1))[0, 1] > 0.8
