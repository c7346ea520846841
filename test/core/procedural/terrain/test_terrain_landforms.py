"""Landforms, against what is known of their shapes."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import pearsonr

from oaisys_core.procedural.terrain import craters
from oaisys_core.procedural.terrain.craters import crater_diameters, crater_field, crater_profile
from oaisys_core.procedural.terrain.erosion import drainage_area, slides, streams
from oaisys_core.procedural.terrain.presets import PRESETS, SHAPED, make_ground
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray

ROUGH = sorted(PRESETS.keys() - {"plane"})

SLOW = {
    "alpine",
    "badlands",
    "canyon",
    "large_terrain",
    "river_bed",
    "slab_dunes",
    "volcanic_field",
}
"""Presets that take seconds to make."""
SEEN = {"canyon", "craters", "dunes", "mounds", "mountain_1"}
"""Presets whose two resolutions are compared in test-full."""


@cache
def smooth_ground(preset: str, size_px: int = 257) -> tuple[np.ndarray, float]:
    rng = np.random.default_rng(0)
    ground = make_ground(preset, 64.0, size_px, rng, roughness=0.0)
    elevation_m = ground.elevation_m.astype(float)
    elevation_m.flags.writeable = False
    return elevation_m, ground.spacing_m


def slopes_deg(elevation_m: np.ndarray, spacing_m: float) -> np.ndarray:
    return np.degrees(np.arctan(np.hypot(*np.gradient(elevation_m, spacing_m))))


@pytest.mark.parametrize(
    "preset",
    [
        pytest.param(preset, marks=pytest.mark.long if preset in SEEN else pytest.mark.soak)
        for preset in ROUGH
    ],
)
def test_a_seed_gives_one_landscape_at_any_resolution(preset: str) -> None:
    coarse, _ = smooth_ground(preset, 129)
    fine, _ = smooth_ground(preset)
    # Where processes run on finer grids, their ways differ a little.
    least = 0.95 if preset in SHAPED else 0.98
    assert pearsonr(coarse.ravel(), fine[::2, ::2].ravel()).statistic > least


@pytest.mark.parametrize(
    "preset",
    [pytest.param(each, marks=pytest.mark.long if each in SLOW else ()) for each in ROUGH],
)
def test_landscapes_are_neither_flat_nor_spiky(preset: str) -> None:
    elevation_m, spacing_m = smooth_ground(preset)
    assert 1.0 < np.ptp(elevation_m) < 25.0
    before, after = np.diff(elevation_m, axis=0)[:-1], -np.diff(elevation_m, axis=0)[1:]
    # A needle or a pit differs from both neighbours in one direction, a cliff in opposite ones.
    lone = np.minimum(np.abs(before), np.abs(after))[before * after > 0]
    assert lone.max() < 2 * spacing_m, "no needles"


def test_sand_lies_no_steeper_than_it_can_and_falls_off_to_one_side() -> None:
    elevation_m, spacing_m = smooth_ground("dunes", 385)
    slope = slopes_deg(elevation_m, spacing_m)
    assert np.quantile(slope, 0.995) < 37.0
    assert slope.max() > 28.0, "there are slip faces"
    steep, gentle = slope > 26, (slope > 3) & (slope < 15)
    assert gentle.sum() > 4 * steep.sum()


def test_tables_are_level_on_top_and_have_cliffs() -> None:
    elevation_m, spacing_m = smooth_ground("mesa", 513)
    slope = slopes_deg(elevation_m, spacing_m)
    top = elevation_m > np.quantile(elevation_m, 0.8)
    assert np.median(slope[top]) < 6
    assert (slope > 60).mean() > 0.01


def test_a_canyon_has_a_floor_a_plateau_and_walls_in_steps() -> None:
    elevation_m, spacing_m = smooth_ground("canyon", 513)
    low, high = elevation_m.min(), elevation_m.max()
    slope = slopes_deg(elevation_m, spacing_m)
    level = slope < 12
    assert (level & (elevation_m < low + 0.15 * (high - low))).mean() > 0.05
    assert (level & (elevation_m > high - 0.25 * (high - low))).mean() > 0.15
    middle = np.abs(elevation_m - (low + high) / 2) < 0.3 * (high - low)
    assert (slope[middle] > 60).mean() > 0.05, "cliffs"
    assert (slope[middle] < 40).mean() > 0.3, "ledges between them"


@pytest.mark.parametrize("preset", ["mountain_2", "large_terrain"])
def test_water_has_cut_valleys_that_branch(preset: str) -> None:
    elevation_m, _ = smooth_ground(preset)
    rank = elevation_m.ravel().argsort().argsort().reshape(elevation_m.shape)
    inner = rank[1:-1, 1:-1]
    around = np.stack(
        [rank[1 + r : 256 + r, 1 + c : 256 + c] for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c]
    )
    pits = (around > inner).all(axis=0).mean()
    assert pits < 0.01, "nearly everything drains"


def test_water_gathers_what_lies_upstream() -> None:
    rng = np.random.default_rng(5)
    # Each cell drains into an earlier one: a random forest with its roots at 0 and 1.
    receiver = np.array([0, 1, *(int(rng.integers(0, i)) for i in range(2, 200))])
    expected = np.ones(200)
    for cell in range(199, 1, -1):
        expected[receiver[cell]] += expected[cell]
    assert (drainage_area(receiver) == expected).all()


def test_streams_flow_down_a_tilted_plain_and_only_take_away() -> None:
    rng = np.random.default_rng(1)
    plain = np.linspace(0, 20, 64)[:, None] + rng.uniform(0, 0.5, (64, 64))
    cut = streams(plain, 1.0, rng, steps=60)
    assert cut.mean() < plain.mean()
    assert cut[5:-5].std(axis=1).mean() > 1.5 * plain[5:-5].std(axis=1).mean(), "valleys"


def test_what_slides_comes_to_rest_and_nothing_is_lost() -> None:
    heap = np.zeros((65, 65))
    heap[28:37, 28:37] = 6.0
    slid = slides(heap, 0.5, steps=600, repose_deg=34.0)
    assert slid.sum() == pytest.approx(heap.sum())
    fall = np.maximum(np.abs(np.diff(slid, axis=0)).max(), np.abs(np.diff(slid, axis=1)).max())
    assert np.degrees(np.arctan(fall / 0.5)) < 36.0


def test_crater_sizes_follow_the_power_law() -> None:
    sizes = crater_diameters(500.0, np.random.default_rng(2), 60.0, 1.0, 0.05, 2.0)
    assert len(sizes) > 5000
    assert sizes.min() >= 1.0
    assert sizes.max() <= 60.0
    bins = np.array([1.5, 3.0, 6.0, 12.0])
    above = [(sizes > b).sum() for b in bins]
    exponent = -np.polyfit(np.log(bins), np.log(above), 1)[0]
    assert exponent == pytest.approx(2.0, abs=0.15)


def test_a_fresh_crater_has_the_depth_and_rim_of_a_lunar_one() -> None:
    radius = np.linspace(0, 4, 4001)
    fresh, old = crater_profile(radius, 1.0), crater_profile(radius, 0.0)
    rim = fresh.max()
    assert rim - fresh.min() == pytest.approx(0.196, rel=0.05)
    assert rim == pytest.approx(0.036, abs=0.006)
    assert radius[fresh.argmax()] == pytest.approx(1.0, abs=0.05)
    assert old.max() - old.min() < 0.4 * (rim - fresh.min())
    assert np.abs(fresh[radius > 2.6]).max() < 0.004


def test_one_crater_is_as_deep_as_its_profile_says() -> None:
    rng = np.random.default_rng(3)
    field = crater_field(257, 40.0, rng, largest_m=16.0, smallest_m=8.0, coverage=0.05)
    assert field.min() < -0.4
    assert 0.05 < field.max() < 1.5


@pytest.mark.parametrize("preset", ["mesa", "canyon"])
def test_cliffs_do_not_follow_the_grid_in_steps(preset: str) -> None:
    """Neighbouring facets face alike; in steps, sunlight along a wall leaves every other black."""
    elevation_m, spacing_m = smooth_ground(preset, 513)
    up_y, up_x = np.diff(elevation_m, axis=0)[:, :-1], np.diff(elevation_m)[:-1]
    slope = np.hypot(up_x, up_y) / spacing_m
    facing = np.arctan2(up_y, up_x)
    steep = slope > np.tan(np.radians(70))
    turned = np.angle(np.exp(1j * np.diff(facing)))[steep[:, 1:] & steep[:, :-1]]
    assert np.degrees(np.sqrt(np.mean(turned**2))) < 9
    assert np.degrees(np.arctan(slope.max())) > 75


@pytest.mark.parametrize(("extent_m", "size_px"), [(16.0, 385), (512.0, 257)])
@pytest.mark.parametrize("share", [None, 0.06, 0.15])
def test_craters_are_a_fifth_as_deep_as_wide_at_any_relief(
    extent_m: float, size_px: int, share: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of fresh ones, which `relief_m` stretched to 0.58 of their diameter (Pike 1977: 0.2)."""
    drawn: list[tuple[FloatArray, float, float]] = []
    add = craters._add_crater

    def record(field: FloatArray, spacing_m: float, *crater: Any) -> None:
        add(field, spacing_m, *crater)
        drawn.append(crater[:3])

    monkeypatch.setattr(craters, "_add_crater", record)
    relief_m = None if share is None else share * extent_m
    rng = np.random.default_rng(1)
    ground = make_ground("craters", extent_m, size_px, rng, roughness=0.0, relief_m=relief_m)

    if relief_m is not None:
        assert np.ptp(ground.elevation_m) == pytest.approx(relief_m, rel=0.35)
    depths = [depth_share(ground, *drawn[index][:2]) for index in complete(drawn, ground)]
    assert depths
    assert 0.16 < np.median(depths) < 0.21
    assert max(depths) < 0.27


def complete(drawn: list[tuple[FloatArray, float, float]], ground: HeightField) -> list[int]:
    """Return the craters that are fresh, inside, of many cells, and hit by no large later one."""
    found = []
    for index, (centre_m, diameter_m, age) in enumerate(drawn):
        if age >= 0.15 or diameter_m < 8 * ground.spacing_m:
            continue
        low_m, high_m = centre_m - 0.499 * diameter_m, centre_m + 0.499 * diameter_m
        inside = low_m.min() > 0 and high_m.max() < ground.extent_m[2] - ground.extent_m[0]
        later = [
            size_m
            for other_m, size_m, _ in drawn[index + 1 :]
            if size_m > diameter_m / 6
            and np.hypot(*(other_m - centre_m)) < 0.8 * (diameter_m + size_m)
        ]
        if inside and not later:
            found.append(index)
    return found


def depth_share(ground: HeightField, centre_m: FloatArray, diameter_m: float) -> float:
    """Return the height of a crater's mean crest over its floor, in diameters."""
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    out = np.column_stack((np.cos(angle), np.sin(angle))) * diameter_m / 2
    middle_m = centre_m + ground.origin_xy_m
    crest_m = [ground.height_at(middle_m + at * out) for at in np.linspace(0.8, 1.15, 15)]
    floor_m = [ground.height_at(middle_m + at * out).mean() for at in (0.0, 0.05, 0.1)]
    return float((np.nanmax(crest_m, axis=0).mean() - min(floor_m)) / diameter_m)


@pytest.mark.parametrize("preset", ["craters", "crater_field"])
def test_more_relief_than_craters_can_have_is_told(
    preset: str, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(2):  # the second time from what is kept
        caplog.clear()
        make_ground(preset, 16.0, 65, np.random.default_rng(0), relief_m=5.0)
        assert "stage.relief_m: received 5, but the largest crater" in caplog.text
    caplog.clear()
    make_ground(preset, 16.0, 65, np.random.default_rng(0), relief_m=2.0)
    assert not caplog.text


def test_craters_of_no_relief_are_level() -> None:
    level = make_ground("craters", 16.0, 65, np.random.default_rng(0), 0.0, relief_m=0.0)
    assert np.ptp(level.elevation_m) == 0
