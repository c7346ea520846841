"""Worlds whose layers bring stones: where they are seen, and what they are not part of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from covered_worlds import assert_belongs_to_the_ground, cover, covered_world, poses, view

from oaisys_core.simulation import Simulation

GRAVEL: dict[str, Any] = {"texture": "gravel", "label": "gravel", "semantic_id": 1}
SAND: dict[str, Any] = {"texture": "sand", "label": "sand", "semantic_id": 2}


def stony_world(*layers: dict[str, Any], stones: bool, **stage: Any) -> Simulation:
    return covered_world(*layers, stage=stage, materials={"loose_stones": stones})


def test_stones_lie_where_their_layer_does() -> None:
    world = stony_world(GRAVEL, SAND, stones=True)
    on_stage = cover(world, on_stage=True)
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
    assert not cover(stony_world(layer, SAND, stones=wanted))


def test_a_layer_may_ask_for_the_stones_of_another() -> None:
    found = cover(stony_world({**GRAVEL, "texture": "mud", "loose_stones": "soil"}, stones=False))
    assert {each.semantic_ids for each in found} == {(1,)}


def test_a_layer_may_have_grass_and_stones() -> None:
    both = stony_world({**GRAVEL, "texture": "turf", "loose_stones": "pebbles"}, stones=False)
    names = {both.scene.prototypes[each.prototype].name for each in cover(both)}
    assert names == {"gravel_grass", "gravel_stones"}


def test_stones_are_seen_as_their_layer_and_are_no_instances() -> None:
    bare, strewn = (view(stony_world(GRAVEL, stones=each), 0.6, 1.5) for each in (False, True))
    ground = np.isfinite(bare["depth"])
    nearer_m = bare["depth"][ground] - strewn["depth"][ground]
    assert (nearer_m > 0.004).mean() > 0.1
    assert nearer_m.min() > -1e-4
    np.testing.assert_array_equal(bare["semantic_0"], strewn["semantic_0"])
    assert not strewn["instance"].any()


def test_stones_are_no_objects_no_heights_and_no_ground_truth() -> None:
    bare, strewn = (stony_world(GRAVEL, stones=each) for each in (False, True))
    assert_belongs_to_the_ground(strewn, bare)


def test_no_stones_lie_on_steep_ground() -> None:
    world = stony_world(GRAVEL, stones=True, preset="mesa")
    xy_m = poses(cover(world, on_stage=True))[:, :2, 3]
    ground, along = world.scene.ground, np.array((0.01, 0.0))
    dx = ground.height_at(xy_m + along) - ground.height_at(xy_m - along)
    dy = ground.height_at(xy_m + along[::-1]) - ground.height_at(xy_m - along[::-1])
    slope_deg = np.degrees(np.arctan(np.hypot(dx, dy) / (2 * along[0])))
    assert len(xy_m) > 50
    assert np.quantile(slope_deg, 0.99) < 42
