"""Water that goes on beyond the stage: it ends at shores alone, in images and labels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pixel_rays, pose_looking_at
from oaisys_core.procedural.terrain.water.beyond_stage import MAX_BEYOND
from oaisys_core.procedural.terrain.water.ponds import FIRST_WATER_ID, MAX_PONDS
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata
from oaisys_core.verification.audit import audit_sample
from oaisys_core.verification.reference_scene import ReferenceScene

EDGE_M, LEVEL_M, WATER_ID = 24.0, 0.2, 40
FIRST_ID = FIRST_WATER_ID + MAX_PONDS
WORLD: dict[str, Any] = {
    "seed": 4,
    "backend": "analytic",
    "stage": {
        "preset": "mounds",
        "extent_m": EDGE_M,
        "resolution_px": 97,
        "water": {"level_m": LEVEL_M, "semantic_id": WATER_ID},
    },
    "materials": {"texture_size_px": 32, "mask": {"size_px": 64}},
    "assets": {
        "rocks": [],
        "groups": [
            {"name": "trees", "shape": "spruce", "count": [80, 80], "size_m": [1.5, 2.5],
             "variants": 1, "label": "tree", "semantic_id": 30}
        ],
    },
    "sensors": {
        "cameras": [
            {"name": "camera", "width_px": 160, "height_px": 160, "fx_px": 80, "fy_px": 80,
             "modalities": ["depth", "semantic_0", "instance"]}
        ],
        "pose_policy": "allow",
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def lakes() -> Iterator[Simulation]:
    simulation = Simulation(config_from_mapping(WORLD))
    simulation.step_batch()
    yield simulation
    simulation.close()


def test_it_ends_at_shores_alone(lakes: Simulation) -> None:
    """Ground that is seen beside water, from above, is not lower than the water."""
    above_m = 40.0
    pose = pose_looking_at((0.0, 0.0, above_m), (0.01, 0.0, 0.0))
    sample = lakes.step_sample(ModuleMetadata(sensor={"pose": pose}))
    frames = {frame.modality: frame for frame in sample.frames}
    depth = frames["depth"]
    rays = pixel_rays(depth.intrinsics) @ depth.T_map_camera[:3, :3].T
    points_m = depth.T_map_camera[:3, 3] + rays * depth.data[..., None]
    is_water = frames["semantic_0"].data == WATER_ID
    is_beyond = (np.abs(points_m[..., :2]) > EDGE_M / 2).any(axis=-1)
    assert (is_water & is_beyond).sum() > 500
    assert (is_water & ~is_beyond).sum() > 500
    np.testing.assert_allclose(points_m[is_water, 2], LEVEL_M, atol=2e-3)
    ids = frames["instance"].data
    assert ids[is_water & is_beyond].min() >= FIRST_ID
    assert ids[is_water & is_beyond].max() < FIRST_ID + MAX_BEYOND < 65_536
    is_ground = ids == 0
    edges = 0
    for axis in (0, 1):
        one, other = (slice(None, -1), slice(1, None))
        pairs = ((one, other), (other, one))
        for wet, dry in pairs:
            at = (wet, slice(None)) if axis == 0 else (slice(None), wet)
            beside = (dry, slice(None)) if axis == 0 else (slice(None), dry)
            is_shore = is_water[at] & is_ground[beside]
            edges += is_shore.sum()
            assert points_m[beside][is_shore, 2].min() > LEVEL_M - 1e-3
    assert edges > 200


def test_it_is_seen_by_an_independent_caster_and_not_in_the_true_mesh() -> None:
    lakes = Simulation(config_from_mapping(WORLD | {"assets": {"rocks": [], "groups": []}}))
    lakes.step_batch()
    pose = pose_looking_at((0.0, 0.0, 9.0), (14.0, 3.0, 0.0))
    sample = lakes.step_sample(ModuleMetadata(sensor={"pose": pose}))
    ids = next(frame.data for frame in sample.frames if frame.modality == "instance")
    assert ((ids >= FIRST_ID) & (ids < FIRST_ID + MAX_BEYOND)).sum() > 100
    mesh = lakes.ground_truth_mesh()
    assert mesh.instance_ids is not None
    assert mesh.instance_ids.max() < FIRST_ID
    reference = ReferenceScene(lakes.scene, mesh)
    for found in audit_sample(sample, reference, np.random.default_rng(1)):
        assert found.wrong <= 5e-4 * found.pixels, found
    lakes.close()


def test_plants_on_the_land_stand_on_dry_ground(lakes: Simulation) -> None:
    water = lakes._current().world.water_beyond()
    land = lakes.scene.far_ground
    assert water is not None
    assert land is not None
    trees = [each for each in lakes.scene.placements if each.on_land and each.semantic_ids == (30,)]
    feet_m = np.concatenate([each.T_map_object[:, :2, 3] for each in trees])
    assert len(feet_m) > 100
    assert not water.covers(feet_m).any()
    around_m = np.random.default_rng(0).uniform(-40, 40, (2000, 2))
    around_m = around_m[(np.abs(around_m) > EDGE_M / 2).any(axis=1)]
    covered = water.covers(around_m)
    assert 0.1 < covered.mean() < 0.9
    assert land.height_at(around_m)[covered].max() < LEVEL_M


def test_there_is_none_where_the_stage_s_edge_is_dry() -> None:
    stage = WORLD["stage"] | {"water": {"level_m": -50.0, "semantic_id": WATER_ID}}
    simulation = Simulation(config_from_mapping(WORLD | {"stage": stage}))
    simulation.step_batch()
    world = simulation._current().world
    beyond = world.water_beyond()
    assert beyond is not None
    assert beyond.parts.placements == ()
    assert beyond.extent_m == simulation.scene.ground.extent_m
    simulation.close()
