"""A wood goes on beyond the stage: in images, labels and lists, but not in the true mesh."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, ObjectQuery, Pose, Sample
from oaisys_core.verification.audit import audit_sample
from oaisys_core.verification.reference_scene import ReferenceScene

TREE_ID = 30
WOOD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"preset": "mounds", "extent_m": 24, "resolution_px": 65, "relief_m": 1.0},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64}},
    "assets": {
        "rocks": [],
        "groups": [
            {"name": "wood", "shape": "birch", "count": [12, 12], "size_m": [2.0, 3.0],
             "variants": 1, "label": "tree", "semantic_id": TREE_ID}
        ],
    },
    "sensors": {
        "cameras": [
            {"name": "camera", "width_px": 64, "height_px": 48, "fx_px": 54, "fy_px": 54,
             "modalities": ["depth", "semantic_0", "instance"]}
        ],
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def wood() -> Iterator[Simulation]:
    simulation = Simulation(config_from_mapping(WOOD))
    simulation.step_batch()
    yield simulation
    simulation.close()


def level_view(simulation: Simulation, **metadata: Any) -> Sample:
    """Look to the horizon from the middle of the stage."""
    z_m = float(simulation.query_height([(0.0, 0.0, 0.0)]).surface_height_m[0]) + 1.5
    pose = Pose((0.0, 0.0, z_m), (0.0, 0.0, 0.0, 1.0))
    return simulation.step_sample(ModuleMetadata(sensor={"pose": pose}, **metadata))


def ids_seen(sample: Sample) -> set[int]:
    frame = next(each for each in sample.frames if each.modality == "instance")
    return set(np.unique(frame.data).tolist()) - {0}


def ids_on_land(simulation: Simulation) -> set[int]:
    placed = [each.instance_ids for each in simulation.scene.placements if each.on_land]
    return set(np.concatenate(placed).tolist()) if placed else set()


def test_trees_beyond_are_seen_and_listed_but_no_part_of_the_true_mesh(wood: Simulation) -> None:
    beyond = ids_on_land(wood)
    seen = ids_seen(level_view(wood))

    assert len(beyond) > 24
    assert len(seen & beyond) >= 3
    mesh = wood.ground_truth_mesh()
    assert mesh.instance_ids is not None
    assert not beyond & set(mesh.instance_ids.tolist())
    assert np.abs(mesh.vertices_m[:, :2]).max() <= 12.0 + 1e-6
    page = wood.list_objects(ObjectQuery(kinds=("group",), limit=1000))
    assert beyond <= {each.instance_id for each in page.objects}
    assert {each.group for each in page.objects} == {"wood"}
    (count,) = wood.info().group_counts
    assert (count.asked, count.placed) == (12, 12)


def test_they_stand_on_the_land_outside_of_the_stage(wood: Simulation) -> None:
    land = wood.scene.far_ground
    assert land is not None
    for placement in wood.scene.placements:
        if not placement.on_land:
            continue
        feet_m = placement.T_map_object[:, :3, 3]
        height_m = land.height_at(feet_m[:, :2])
        size_m = np.linalg.norm(placement.T_map_object[:, :3, 0], axis=1)
        assert (feet_m[:, 2] <= height_m + 1e-6).all()
        assert (feet_m[:, 2] > height_m - size_m).all()
        assert (np.abs(feet_m[:, :2]).max(axis=1) > 12 + size_m / 2).all()


def test_an_independent_caster_sees_the_same(wood: Simulation) -> None:
    reference = ReferenceScene(wood.scene, wood.ground_truth_mesh())
    sample = level_view(wood)
    for found in audit_sample(sample, reference, np.random.default_rng(1)):
        assert found.wrong <= 5e-4 * found.pixels, found


def test_a_hidden_group_is_hidden_there_too(wood: Simulation) -> None:
    sample = level_view(wood, asset={"groups": {"wood": {"hidden": True}}})
    assert not ids_seen(sample)
    sample = level_view(wood, asset={"groups": {"wood": {"hidden": False}}})
    assert ids_seen(sample) & ids_on_land(wood)


def test_without_land_nothing_floats(wood: Simulation) -> None:
    sample = level_view(wood, environment={"ground_beyond": False})
    assert not ids_on_land(wood)
    assert min(ids_seen(sample), default=0) < 59_001
    level_view(wood, environment={"ground_beyond": True})
    assert ids_on_land(wood)


@pytest.mark.parametrize(
    ("stage", "group"), [({"surroundings": "plain"}, {}), ({}, {"beyond_stage": False})]
)
def test_a_plain_or_a_word_keeps_them_on_the_stage(
    stage: dict[str, Any], group: dict[str, Any]
) -> None:
    many = WOOD["assets"]["groups"][0] | {"count": 40}
    assets = {"rocks": [], "groups": [many | group]}
    simulation = Simulation(
        config_from_mapping(WOOD | {"stage": WOOD["stage"] | stage, "assets": assets})
    )
    simulation.step_batch()
    assert not ids_on_land(simulation)
    assert len(ids_seen(level_view(simulation))) >= 1
    simulation.close()
