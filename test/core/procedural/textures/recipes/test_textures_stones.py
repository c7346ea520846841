"""Stones poured over a tile."""

import numpy as np
import pytest

from oaisys_core.procedural.textures.recipes.stones import StoneBed, StoneSpec

SIZE = 256


def poured(seed: int, *pours: StoneSpec) -> StoneBed:
    bed = StoneBed(np.zeros((SIZE, SIZE), np.float32))
    rng = np.random.default_rng(seed)
    for pour in pours:
        bed.add_stones(pour, rng)
    return bed


def test_stones_rise_above_the_ground_and_nowhere_below() -> None:
    bed = poured(0, StoneSpec(200, (0.02, 0.06)))
    covered = bed.ids >= 0
    assert 0.15 < covered.mean() < 0.6
    assert (bed.height[covered] > 0).all()
    assert (bed.height[~covered] == 0).all()
    assert bed.above.min() == 0
    assert 0.9 < bed.above.max() <= 1


def test_a_stone_is_convex_seen_from_above() -> None:
    bed = poured(3, StoneSpec(1, (0.2, 0.2), edge=0.03))
    # Along every row and column, a convex body's height has no positive second difference.
    stone = np.where(bed.ids >= 0, bed.height, np.nan).astype(float)
    for axis in (0, 1):
        bend = np.diff(stone, 2, axis=axis)
        assert np.isfinite(bend).sum() > 1000
        assert np.nanmax(bend) < 1e-6


def test_edges_of_the_tile_cut_no_stone() -> None:
    bed = poured(1, StoneSpec(300, (0.03, 0.08)))
    for axis in (0, 1):
        inside = np.abs(np.diff(bed.height, axis=axis)).mean()
        seam = np.abs(bed.height.take(0, axis) - bed.height.take(-1, axis)).mean()
        assert seam < 1.5 * inside


def test_a_later_pour_lies_on_an_earlier_one() -> None:
    below = poured(2, StoneSpec(400, (0.03, 0.05)))
    both = poured(2, StoneSpec(400, (0.03, 0.05)), StoneSpec(30, (0.05, 0.05), buried=0.0))
    assert (both.height >= below.height).all()
    assert both.count == below.count + 30
    assert both.height.max() > below.height.max()


def test_density_keeps_stones_where_it_is_high() -> None:
    density = np.zeros((SIZE, SIZE), np.float32)
    density[: SIZE // 2] = 1
    bed = StoneBed(np.zeros((SIZE, SIZE), np.float32))
    bed.add_stones(StoneSpec(300, (0.01, 0.02)), np.random.default_rng(4), density)
    covered = bed.ids >= 0
    assert covered[20 : SIZE // 2 - 20].mean() > 0.04
    assert not covered[SIZE // 2 + 20 : -20].any()


def test_sizes_follow_their_law() -> None:
    bed = poured(5, StoneSpec(4000, (0.004, 0.04), exponent=2.0))
    assert bed.count == 4000
    area_px = np.bincount(bed.ids[bed.ids >= 0], minlength=bed.count)
    # Larger stones come later; half of all are below 2**(1 / 2) times the smallest.
    assert area_px[3600:].mean() > 8 * area_px[:2000].mean()


@pytest.mark.parametrize("seed", [0, 7])
def test_equal_seeds_give_equal_beds(seed: int) -> None:
    one, two = (poured(seed, StoneSpec(500, (0.01, 0.05))) for _ in range(2))
    assert one.height.tobytes() == two.height.tobytes()
    assert one.ids.tobytes() == two.ids.tobytes()
