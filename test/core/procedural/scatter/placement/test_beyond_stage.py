"""Plants on the land around a stage: how many there are, and where they stand."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.procedural.scatter.ids import ON_LAND
from oaisys_core.procedural.scatter.placement.beyond_stage import (
    REACH,
    PlacesBeyond,
    goes_beyond,
    plant_places_beyond,
)
from oaisys_core.procedural.terrain.surroundings.far_ground import GroundAround
from oaisys_core.procedural.terrain.surroundings.kinds import Surroundings
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray

EDGE_M = 40.0


def around() -> GroundAround:
    """A gently rolling stage, and the land around it."""
    axis = np.linspace(-EDGE_M / 2, EDGE_M / 2, 65)
    height = np.sin(axis[None, :] / 5) * np.cos(axis[:, None] / 7)
    stage = HeightField(height.astype(np.float32), (-EDGE_M / 2, -EDGE_M / 2), EDGE_M / 64)
    return GroundAround(stage, Surroundings("land", 5).around(stage, None))


GROUND = around()


def group(**keys: object) -> GroupConfig:
    given = {"name": "g", "shape": "spruce", "count": (1, 1), "label": "tree", "semantic_id": 10}
    return GroupConfig.model_validate(given | {"max_slope_deg": 90} | keys)


def found(count: int, size_m: float, seed: int = 1, **keys: object) -> PlacesBeyond:
    """Return the places beyond a stage with so many plants of a size."""
    rng = np.random.default_rng(seed)
    xy_m = rng.uniform(-EDGE_M / 2, EDGE_M / 2, (count, 2))
    sizes_m = np.full(count, size_m)
    return plant_places_beyond(group(size_m=(0.1, 30), **keys), xy_m, sizes_m, GROUND, None, rng)


def from_edge_m(xy_m: FloatArray) -> FloatArray:
    return np.hypot(*np.maximum(np.abs(xy_m) - EDGE_M / 2, 0).T)


def area_m2(low_m: float, high_m: float) -> float:
    """Return the area between two distances from the stage, whose corners are round."""
    low, high = (4 * EDGE_M * each + np.pi * each**2 for each in (low_m, high_m))
    return float(high - low)


def test_numbers_go_on_at_the_edge_and_fall_off_evenly() -> None:
    size_m = 0.5
    places = found(20_000, size_m, spacing=0.0)
    assert len(places.xy_m) == ON_LAND, "fewer than stand within the whole reach"

    far = found(600, size_m)
    away_m, reach_m = from_edge_m(far.xy_m), REACH * size_m
    per_m2 = 600 / EDGE_M**2
    for low, high in ((0.02, 0.25), (0.25, 0.5), (0.5, 1.0)):
        low_m, high_m = low * reach_m, high * reach_m
        steps = np.linspace(low_m, high_m, 200)
        share = np.diff([area_m2(0, each) for each in steps])
        middle = (steps[1:] + steps[:-1]) / 2
        expected = float((per_m2 * (1 - middle / reach_m) * share).sum())
        seen = np.count_nonzero((away_m >= low_m) & (away_m < high_m))
        assert abs(seen - expected) < 4 * np.sqrt(expected) + 0.05 * expected


def test_nothing_leans_over_the_edge() -> None:
    places = found(300, 3.0)
    beyond_m = np.abs(places.xy_m).max(axis=1) - EDGE_M / 2
    assert len(places.xy_m) > 100
    assert beyond_m.min() > 1.5
    assert places.distance == pytest.approx(from_edge_m(places.xy_m) / 3.0)


def test_large_plants_stand_far_away_and_small_ones_near() -> None:
    far, near = (from_edge_m(found(40, size_m).xy_m) for size_m in (8.0, 1.0))
    assert 0.6 * REACH * 8 < far.max() < REACH * 8
    assert near.max() < REACH


def test_the_same_draws_have_the_same_places() -> None:
    first, again = found(200, 2.0), found(200, 2.0)
    assert np.array_equal(first.xy_m, again.xy_m)
    assert not np.array_equal(first.xy_m[:50], found(200, 2.0, seed=2).xy_m[:50])


def test_a_steep_land_has_none_of_those_that_stand_on_gentle_ground() -> None:
    none = found(200, 2.0, density=[{"kind": "slope", "range_deg": [70, 90], "fade_deg": 0}])
    gentle = found(200, 2.0, max_slope_deg=4.0)
    assert not len(none.xy_m)
    step = np.array((GROUND.spacing_m, 0.0))
    rise = [
        (GROUND.height_at(gentle.xy_m + way) - GROUND.height_at(gentle.xy_m - way))
        / (2 * GROUND.spacing_m)
        for way in (step, step[::-1])
    ]
    assert 10 < len(gentle.xy_m) < len(found(200, 2.0).xy_m)
    assert np.degrees(np.arctan(np.hypot(*rise))).max() <= 4.0 + 1e-9


def test_who_goes_beyond() -> None:
    assert goes_beyond(group(size_m=(4, 9)))
    assert not goes_beyond(group(size_m=(0.2, 0.9)))
    assert goes_beyond(group(size_m=(0.2, 0.9), beyond_stage=True))
    assert not goes_beyond(group(size_m=(4, 9), beyond_stage=False))
    assert goes_beyond(group(shape="boulder", size_m=(0.2, 0.9)))
    assert not goes_beyond(group(shape="rover", size_m=(4, 9)))
