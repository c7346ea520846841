"""Worlds whose layers bring stones: where they are seen, and what they are not part of."""

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

GRAVEL: dict[str, Any] = {"texture": "gravel", "label": "gravel", "semantic_id": 1}
SAND: dict[str, Any] = {"texture": "sand", "label": "sand", "semantic_id": 2}


def simulation(*layers: dict[str, Any], stones: bool, **stage: Any) -> Simulation:
    config = {
        "seed": 4,
        "backend": "analytic",
        "stage": {"preset": "mounds", "extent_m": 16.0, "resolution_px": 65, **stage},
        "materials": {
            "layers": layers,
            "texture_size_px": 128,
            "mask": {"size_px": 256},
            "loose_stones": stones,
        },
        "assets": {"rocks": []},
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


def stones(simulation: Simulation) -> list[Placement]:
    return [each for each in simulation.scene.placements if each.is_ground_cover]


def poses(placements: list[Placement]) -> NDArray[np.float64]:
    return np.concatenate([each.T_map_object for each in placements])


def view(simulation: Simulation) -> dict[str, Any]:
    z_m = float(simulation.query_height([(0, 0, 0)]).ground_height_m[0])
    pose = pose_looking_at((0, 0, z_m + 0.6), (1.5, 0, z_m))
    return {
        each.modality: each.data
        for each in simulation.step_sample(ModuleMetadata(sensor={"pose": pose})).frames
    }


def test_stones_lie_where_their_layer_does() -> None:
    world = simulation(GRAVEL, SAND, stones=True)
    on_stage = [each for each in stones(world) if not each.on_land]
    xy_m = poses(on_stage)[:, :2, 3]
    assert len(xy_m) > 200
    assert world.scene.material.weights_at(xy_m)[:, 0].min() > 0.05
    assert {each.semantic_ids for each in on_stage} == {(1,)}


@pytest.mark.parametrize(
    ("layer", "wanted"),
    [
        (GRAVEL, False),
        ({**GRAVEL, "loose_stones": "none"}, True),
        ({**GRAVEL, "texture": "sand"}, True),
    ],
)
def test_none_lie_where_none_are_wanted(layer: dict[str, Any], wanted: bool) -> None:
    assert not stones(simulation(layer, SAND, stones=wanted))


def test_a_layer_may_ask_for_the_stones_of_another() -> None:
    found = stones(simulation({**GRAVEL, "texture": "mud", "loose_stones": "soil"}, stones=False))
    assert {each.semantic_ids for each in found} == {(1,)}


def test_a_layer_may_have_grass_and_stones() -> None:
    both = simulation({**GRAVEL, "texture": "turf", "loose_stones": "pebbles"}, stones=False)
    names = {both.scene.prototypes[each.prototype].name for each in stones(both)}
    assert names == {"gravel_grass", "gravel_stones"}


def test_stones_are_seen_as_their_layer_and_are_no_instances() -> None:
    bare, strewn = (view(simulation(GRAVEL, stones=each)) for each in (False, True))
    ground = np.isfinite(bare["depth"])
    nearer_m = bare["depth"][ground] - strewn["depth"][ground]
    assert (nearer_m > 0.004).mean() > 0.1
    assert nearer_m.min() > -1e-4
    np.testing.assert_array_equal(bare["semantic_0"], strewn["semantic_0"])
    assert not strewn["instance"].any()


def test_stones_are_no_objects_no_heights_and_no_ground_truth() -> None:
    bare, strewn = (simulation(GRAVEL, stones=each) for each in (False, True))
    assert strewn.list_objects(ObjectQuery()).total == 0
    feet = poses([each for each in stones(strewn) if not each.on_land])[:50, :3, 3]
    found = strewn.query_height(feet)
    np.testing.assert_allclose(found.surface_height_m, found.ground_height_m, atol=1e-9)
    one, other = strewn.ground_truth_mesh(), bare.ground_truth_mesh()
    np.testing.assert_array_equal(one.triangles, other.triangles)


def test_no_stones_lie_on_steep_ground() -> None:
    world = simulation(GRAVEL, stones=True, preset="canyon")
    xy_m = poses([each for each in stones(world) if not each.on_land])[:, :2, 3]
    ground, along = world.scene.ground, np.array((0.01, 0.0))
    dx = ground.height_at(xy_m + along) - ground.height_at(xy_m - along)
    dy = ground.height_at(xy_m + along[::-1]) - ground.height_at(xy_m - along[::-1])
    slope_deg = np.degrees(np.arctan(np.hypot(dx, dy) / (2 * along[0])))
    assert len(xy_m) > 50
    assert np.quantile(slope_deg, 0.99) < 42
