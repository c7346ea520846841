"""Rocks go on beyond the stage: in images, labels and lists, but not in the true mesh."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.procedural.scatter.placement.beyond_stage import REACH
from oaisys_core.scene import Placement
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, ObjectQuery, Pose
from oaisys_core.verification.audit import audit_sample
from oaisys_core.verification.reference_scene import ReferenceScene

ROCK_ID = 12
EDGE_M = 24.0
ROCKS: dict[str, Any] = {"count": [400, 400], "size_m": [0.3, 1.5], "semantic_id": ROCK_ID}
WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"preset": "mounds", "extent_m": EDGE_M, "resolution_px": 65, "relief_m": 1.0},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64}},
    "assets": {"rocks": [ROCKS, ROCKS | {"kind": "rounded", "count": [40, 40]}]},
    "sensors": {
        "cameras": [
            {"name": "camera", "width_px": 64, "height_px": 48, "fx_px": 54, "fy_px": 54,
             "modalities": ["depth", "semantic_0", "instance"]}
        ],
    },
}  # fmt: skip


def simulation_of(**rocks: Any) -> Simulation:
    assets = {"rocks": [each | rocks for each in WORLD["assets"]["rocks"]]}
    simulation = Simulation(config_from_mapping(WORLD | {"assets": assets}))
    simulation.step_batch()
    return simulation


@pytest.fixture(scope="module")
def rocky() -> Iterator[Simulation]:
    simulation = simulation_of()
    yield simulation
    simulation.close()


def on_land(simulation: Simulation) -> list[Placement]:
    return [each for each in simulation.scene.placements if each.on_land]


def sizes_m(placement: Placement) -> Any:
    return np.linalg.norm(placement.T_map_object[:, :3, 0], axis=1)


def test_their_number_goes_on_at_the_edge_of_the_stage(rocky: Simulation) -> None:
    """Within a distance that is small beside their reach, density is that of the stage."""
    # On the stage, they keep 1.5 m from the edge, as the largest one may need.
    per_m2 = 440 / (EDGE_M - 3.0) ** 2
    band_m = 2.0
    places_m = np.concatenate([each.T_map_object[:, :2, 3] for each in on_land(rocky)])
    beyond_m = np.abs(places_m).max(axis=1) - EDGE_M / 2
    near = int((beyond_m <= band_m).sum())
    # Those of 0.3 m are 12 % fewer there in the mean, and none is half over the edge.
    expected = per_m2 * ((EDGE_M + 2 * band_m) ** 2 - EDGE_M**2)
    assert 0.65 * expected < near < 1.1 * expected


def test_they_lie_on_the_land_and_large_ones_farther_away(rocky: Simulation) -> None:
    land = rocky.scene.far_ground
    assert land is not None
    for placement in on_land(rocky):
        size_m = sizes_m(placement)
        vertices = rocky.scene.prototypes[placement.prototype].vertices_m
        for T_map_object in placement.T_map_object:
            points_m = vertices @ T_map_object[:3, :3].T + T_map_object[:3, 3]
            above_m = points_m[:, 2] - land.height_at(points_m[:, :2])
            assert above_m.min() < 0, "one floats"
            assert above_m.max() > 0, "one is buried"
        centers_m = placement.T_map_object[:, :2, 3]
        beyond_m = np.hypot(*np.maximum(np.abs(centers_m) - EDGE_M / 2, 0).T)
        assert (beyond_m > size_m / 2 - 1e-9).all()
        assert (beyond_m < REACH * size_m).all()


def test_ids_are_of_rocks_of_their_own_and_fit_into_16_bits(rocky: Simulation) -> None:
    beyond = [set(np.concatenate([each.instance_ids]).tolist()) for each in on_land(rocky)]
    ids = set().union(*beyond)
    assert sum(map(len, beyond)) == len(ids)
    assert min(ids) >= 10_001 - 2 * 1000
    assert max(ids) <= 10_000
    asked = tuple(sorted(ids))[:1000]
    listed = rocky.list_objects(ObjectQuery(kinds=("rock",), instance_ids=asked, limit=1000))
    assert [each.instance_id for each in listed.objects] == list(asked)
    before = rocky.list_objects(ObjectQuery(limit=440)).objects
    assert [each.instance_id for each in before] == list(range(1, 441))
    mesh = rocky.ground_truth_mesh()
    assert mesh.instance_ids is not None
    assert not ids & set(mesh.instance_ids.tolist())


def test_an_independent_caster_sees_the_same(rocky: Simulation) -> None:
    z_m = float(rocky.query_height([(0.0, 9.0, 0.0)]).surface_height_m[0]) + 1.5
    level = Pose((0.0, 9.0, z_m), (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    sample = rocky.step_sample(ModuleMetadata(sensor={"pose": level}))
    instance = next(each for each in sample.frames if each.modality == "instance").data
    of_land = np.concatenate([each.instance_ids for each in on_land(rocky)])
    assert np.isin(instance, of_land).sum() > 10
    reference = ReferenceScene(rocky.scene, rocky.ground_truth_mesh())
    for found in audit_sample(sample, reference, np.random.default_rng(1)):
        assert found.wrong <= 5e-4 * found.pixels, found


def test_those_of_the_stage_are_the_same_without_them(rocky: Simulation) -> None:
    alone = simulation_of(beyond_stage=False)
    assert not on_land(alone)
    kept = [each for each in rocky.scene.placements if not each.on_land]
    for one, other in zip(alone.scene.placements, kept, strict=True):
        np.testing.assert_array_equal(one.T_map_object, other.T_map_object)
        np.testing.assert_array_equal(one.instance_ids, other.instance_ids)
    alone.close()


def test_no_id_is_given_twice_where_rocks_are_more_than_their_block_holds() -> None:
    many = simulation_of(count=[9500, 9500], size_m=[0.05, 0.6])
    ids = np.concatenate([each.instance_ids for each in many.scene.placements])
    assert len(ids) == len(np.unique(ids)) > 19_000
    assert all(each.kind == "rock" for each in many.list_objects(ObjectQuery(limit=1000)).objects)
    many.close()
