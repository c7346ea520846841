"""Worlds whose layers bring grass: where it is seen, and what it is not part of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from covered_worlds import assert_belongs_to_the_ground, cover, covered_world, poses, view

TURF: dict[str, Any] = {"texture": "turf", "label": "turf", "semantic_id": 1}
SOIL: dict[str, Any] = {"texture": "soil", "label": "soil", "semantic_id": 2}


def test_a_layer_of_turf_brings_grass_where_it_lies() -> None:
    world = covered_world(TURF, SOIL)
    on_stage = cover(world, on_stage=True)
    xy_m = poses(on_stage)[:, :2, 3]
    assert len(xy_m) > 200
    material = world.scene.material
    assert material.weights_at(xy_m)[:, 0].min() > 0.05
    assert {each.semantic_ids for each in on_stage} == {(1,)}


def test_the_same_seed_draws_the_same_grass() -> None:
    first, second = cover(covered_world(TURF, SOIL)), cover(covered_world(TURF, SOIL))
    assert poses(first).tobytes() == poses(second).tobytes()


@pytest.mark.parametrize(
    "layer",
    [{**TURF, "sward": "none"}, {**TURF, "texture": "moss"}, {**TURF, "texture": "gravel"}],
)
def test_other_layers_bring_none(layer: dict[str, Any]) -> None:
    assert not cover(covered_world(layer, SOIL))


def test_any_layer_may_ask_for_grass() -> None:
    found = cover(covered_world({**TURF, "texture": "moss", "sward": "grass"}, SOIL))
    assert {each.semantic_ids for each in found} == {(1,)}


def test_a_group_of_grass_replaces_that_of_its_layer() -> None:
    group = {"name": "own", "shape": "grass_tuft", "count": [5, 5], "label": "g", "semantic_id": 9}
    here = {**group, "density": [{"kind": "layer", "label": "turf"}]}
    there = {**group, "density": [{"kind": "layer", "label": "soil"}]}
    assert not cover(covered_world(TURF, SOIL, assets={"groups": [here]}))
    assert cover(covered_world(TURF, SOIL, assets={"groups": [there]}))


def test_grass_is_seen_as_its_layer_and_is_no_instance() -> None:
    bare, grown = (
        view(covered_world({**TURF, "sward": each}), 1.2, 3) for each in ("none", "turf")
    )
    ground = np.isfinite(bare["depth"])
    nearer_m = bare["depth"][ground] - grown["depth"][ground]
    assert (nearer_m > 0.02).mean() > 0.15
    assert nearer_m.min() > -1e-4
    np.testing.assert_array_equal(bare["semantic_0"][ground], grown["semantic_0"][ground])
    assert not grown["instance"].any()


def test_grass_is_no_object_no_height_and_no_ground_truth() -> None:
    bare, grown = (covered_world({**TURF, "sward": each}) for each in ("none", "turf"))
    assert_belongs_to_the_ground(grown, bare)


def test_grass_does_not_move_other_things() -> None:
    rocks = [{"kind": "angular", "count": [20, 20]}]
    bare, grown = (
        covered_world({**TURF, "sward": each}, assets={"rocks": rocks}).scene.placements
        for each in ("none", "turf")
    )
    others = [each for each in grown if not each.is_ground_cover]
    for one, other in zip(bare, others, strict=True):
        np.testing.assert_array_equal(one.T_map_object, other.T_map_object)
        np.testing.assert_array_equal(one.instance_ids, other.instance_ids)
