"""Plants on the ground: in tufts, where it is moist and not steep, and as often as asked for."""

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.masks.cover import (
    WAVES_M,
    habitat,
    is_green,
    is_snowy,
    tuft_deviation,
    tuft_softness,
    tufts,
    visible_share,
)
from oaisys_core.procedural.terrain.masks.patches import blend_masks
from oaisys_core.procedural.terrain.masks.relief import Relief
from oaisys_core.procedural.terrain.surroundings.land_masks import PatchyLandMasks
from oaisys_core.procedural.textures.library import make_texture_set

SIZE, EXTENT_M = 256, 50.0


def masks(green: tuple[bool, ...], sharpness: float = 0.15) -> NDArray[np.float32]:
    rng = np.random.default_rng(4)
    return blend_masks(len(green), EXTENT_M, SIZE, rng, 9.0, sharpness, green=green)


def borders_per_m(weights: NDArray[np.float32]) -> float:
    """How often a line changes its layer."""
    heaviest = weights.argmax(axis=0)
    changes = sum(np.count_nonzero(np.diff(heaviest, axis=axis)) for axis in (0, 1))
    return changes / (2 * SIZE * EXTENT_M)


@pytest.mark.parametrize(
    ("name", "expected"), [("grass", True), ("moss", True), ("soil", False), ("gravel", False)]
)
def test_textures_of_plants_are_green(name: str, expected: bool) -> None:
    assert is_green(make_texture_set(name, 64, 0)) is expected


def test_tufts_show_the_octaves_that_texels_can() -> None:
    shortest_m, longest_m = WAVES_M
    assert visible_share(shortest_m / 4) == 1
    assert visible_share(longest_m) == 0
    assert visible_share(np.sqrt(shortest_m * longest_m) / 2) == pytest.approx(0.5)
    for texel_m in (0.1, 0.5, 1.0):
        found = tufts(SIZE, texel_m, np.random.default_rng(1)).var()
        assert found == pytest.approx(float(visible_share(texel_m)), abs=0.02)


def test_a_share_is_the_same_whether_its_tufts_are_seen_or_not() -> None:
    """The width of the unseen is that of a normal distribution: of the difference of two noises."""
    ahead = np.linspace(-3, 3, 13)
    rng = np.random.default_rng(2)
    difference = tuft_deviation(0.0) * np.diff(rng.standard_normal((2, 100_000)), axis=0)
    seen = (difference + ahead[:, None] > 0).mean(axis=1)
    unseen = 1 / (1 + np.exp(-ahead / np.sqrt(tuft_softness(0, 0) ** 2 - tuft_softness(0, 1) ** 2)))
    np.testing.assert_allclose(unseen, seen, atol=0.015)


def test_plants_have_crisp_tufts_and_bare_ground_changes_gradually() -> None:
    plants, bare = masks((True, False)), masks((False, False))
    assert (plants.max(axis=0) > 0.9).mean() > 0.6
    assert (bare.max(axis=0) > 0.9).mean() < 0.5
    assert borders_per_m(plants) > 1.5 * borders_per_m(bare)
    assert borders_per_m(masks((True, False), 1.0)) < 0.8 * borders_per_m(plants)


def test_layers_of_both_kinds_keep_their_shares() -> None:
    found = masks((True, False, True, False))
    np.testing.assert_allclose(found.sum(axis=0), 1, atol=1e-5)
    won = np.bincount(found.argmax(axis=0).ravel()) / found[0].size
    np.testing.assert_allclose(won, 0.25, atol=0.05)


def test_plants_prefer_moist_ground_that_is_not_steep() -> None:
    slope_rad = np.radians(np.array([[0.0, 30.0, 45.0, 60.0]], np.float32))
    level = Relief(np.zeros((1, 4), np.float32), np.zeros((1, 4), np.float32))
    moist = habitat(level, np.array([[0.0, 0.3, 0.7, 1.0]], np.float32))[0]
    steep = habitat(level._replace(slope_rad=slope_rad), np.full((1, 4), 0.5, np.float32))[0]
    assert (np.diff(moist) > 0).all()
    assert steep[0] == steep[1] > steep[2] > steep[3]


def test_plants_on_the_land_have_the_shares_of_the_stage_near_and_far() -> None:
    extent_m = (-32.0, -32.0, 32.0, 32.0)
    land = PatchyLandMasks(extent_m, (0.7, 0.3), 9.0, 2.0, 3, None, (False, True), 0.15)
    weights = land.weights
    np.testing.assert_allclose(weights.sum(axis=0), 1, atol=1e-5)
    near = slice(0, int(land.rows_per_e_fold))
    for rows in (near, slice(near.stop, 3 * near.stop)):
        assert weights[1, rows].mean() == pytest.approx(0.3, abs=0.1)
    crisp = (weights.max(axis=0) > 0.9).mean(axis=1)
    assert crisp[:50].mean() > 0.6, "tufts where cells are small"


def test_snow_has_edges_where_stones_and_sand_mix() -> None:
    mixed, clear = (
        blend_masks(2, EXTENT_M, SIZE, np.random.default_rng(4), 9.0, 0.15, snowy=(False, is_snow))
        for is_snow in (False, True)
    )
    between = [((each > 0.1) & (each < 0.9)).mean() for each in (mixed[1], clear[1])]
    assert between[0] > 0.8
    assert between[1] < 0.5 * between[0]
    assert clear[1].mean() == pytest.approx(0.5, abs=0.05)


def test_snow_on_the_land_has_edges() -> None:
    extent_m = (-32.0, -32.0, 32.0, 32.0)
    land = PatchyLandMasks(
        extent_m, (0.6, 0.4), 9.0, 2.0, 3, sharpness=0.15, is_snowy=(False, True)
    )
    near = land.weights[1, : land.rows // 4]
    assert ((near > 0.1) & (near < 0.9)).mean() < 0.45


@pytest.mark.parametrize(
    ("name", "expected"), [("snow", True), ("sastrugi", True), ("salt_crust", False)]
)
def test_snow_is_known_by_its_reflectance(name: str, expected: bool) -> None:
    assert is_snowy(make_texture_set(name, 64, 0)) is expected
