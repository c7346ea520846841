"""Worlds whose layers bring grass: where it is seen, and what it is not part of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_looking_at
from oaisys_core.scene import Placement
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, ObjectQuery

TURF: dict[str, Any] = {"texture": "turf", "label": "turf", "semantic_id": 1}
SOIL: dict[str, Any] = {"texture": "soil", "label": "soil", "semantic_id": 2}


def simulation(*layers: dict[str, Any], **assets: Any) -> Simulation:
    config = {
        "seed": 4,
        "backend": "analytic",
        "stage": {"preset": "mounds", "extent_m": 16.0, "resolution_px": 65},
        "materials": {"layers": layers, "texture_size_px": 128, "mask": {"size_px": 256}},
        "assets": {"rocks": [], **assets},
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


def grass(simulation: Simulation) -> list[Placement]:
    return [each for each in simulation.scene.placements if each.is_ground_cover]


def poses(placements: list[Placement]) -> NDArray[np.float64]:
    return np.concatenate([each.T_map_object for each in placements])


def view(simulation: Simulation) -> dict[str, Any]:
    z_m = float(simulation.query_height([(0, 0, 0)]).ground_height_m[0])
    pose = pose_looking_at((0, 0, z_m + 1.2), (3, 0, z_m))
    return {
        each.modality: each.data
        for each in simulation.step_sample(ModuleMetadata(sensor={"pose": pose})).frames
    }


def test_a_layer_of_turf_brings_grass_where_it_lies() -> None:
    world = simulation(TURF, SOIL)
    on_stage = [each for each in grass(world) if not each.on_land]
    xy_m = poses(on_stage)[:, :2, 3]
    assert len(xy_m) > 200
    material = world.scene.material
    assert material.weights_at(xy_m)[:, 0].min() > 0.05
    assert {each.semantic_ids for each in on_stage} == {(1,)}


def test_the_same_seed_draws_the_same_grass() -> None:
    first, second = grass(simulation(TURF, SOIL)), grass(simulation(TURF, SOIL))
    assert poses(first).tobytes() == poses(second).tobytes()


@pytest.mark.parametrize(
    "layer",
    [{**TURF, "sward": "none"}, {**TURF, "texture": "moss"}, {**TURF, "texture": "gravel"}],
)
def test_other_layers_bring_none(layer: dict[str, Any]) -> None:
    assert not grass(simulation(layer, SOIL))


def test_any_layer_may_ask_for_grass() -> None:
    found = grass(simulation({**TURF, "texture": "moss", "sward": "grass"}, SOIL))
    assert {each.semantic_ids for each in found} == {(1,)}


def test_a_group_of_grass_replaces_that_of_its_layer() -> None:
    group = {"name": "own", "shape": "grass_tuft", "count": [5, 5], "label": "g", "semantic_id": 9}
    here = {**group, "density": [{"kind": "layer", "label": "turf"}]}
    there = {**group, "density": [{"kind": "layer", "label": "soil"}]}
    assert not grass(simulation(TURF, SOIL, groups=[here]))
    assert grass(simulation(TURF, SOIL, groups=[there]))


def test_grass_is_seen_as_its_layer_and_is_no_instance() -> None:
    bare, grown = (view(simulation({**TURF, "sward": each})) for each in ("none", "turf"))
    ground = np.isfinite(bare["depth"])
    nearer_m = bare["depth"][ground] - grown["depth"][ground]
    assert (nearer_m > 0.02).mean() > 0.15
    assert nearer_m.min() > -1e-4
    np.testing.assert_array_equal(bare["semantic_0"][ground], grown["semantic_0"][ground])
    assert not grown["instance"].any()


def test_grass_is_no_object_no_height_and_no_ground_truth() -> None:
    bare, grown = (simulation({**TURF, "sward": each}) for each in ("none", "turf"))
    assert grown.list_objects(ObjectQuery()).total == 0
    feet = poses([each for each in grass(grown) if not each.on_land])[:50, :3, 3]
    found = grown.query_height(feet)
    np.testing.assert_allclose(found.surface_height_m, found.ground_height_m, atol=1e-9)
    one, other = grown.ground_truth_mesh(), bare.ground_truth_mesh()
    np.testing.assert_array_equal(one.triangles, other.triangles)


def test_grass_does_not_move_other_things() -> None:
    rocks = [{"kind": "angular", "count": [20, 20]}]
    bare, grown = (
        simulation({**TURF, "sward": each}, rocks=rocks).scene.placements
        for each in ("none", "turf")
    )
    others = [each for each in grown if not each.is_ground_cover]
    for one, other in zip(bare, others, strict=True):
        np.testing.assert_array_equal(one.T_map_object, other.T_map_object)
        np.testing.assert_array_equal(one.instance_ids, other.instance_ids)
