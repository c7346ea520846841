"""Planners: their comparison, and what they see in a rendered world."""

from __future__ import annotations

import re
import sys
from typing import Any

import numpy as np
import pytest
import scipy.stats
from repository import REPOSITORY
from synthetic_worlds import SMALL_MATERIALS
from walls import CAMERA, seen_wall

from oaisys_core.config.loading import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, pose_to_matrix
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata
from oaisys_mapping.exploration.coverage import SurfaceCoverage, random_poses
from oaisys_mapping.exploration.coverage_record import (
    CoverageRecord,
    comparison_lines,
    median_interval,
    planner_results,
)
from oaisys_mapping.exploration.gain import ViewScorer
from oaisys_mapping.exploration.occupancy_map import (
    Bounds,
    OccupancyMap,
)
from oaisys_mapping.exploration.planner import Situation, Vehicle, level_pose
from oaisys_mapping.exploration.planners import BUILT_IN_PLANNERS, make_planner, vantage_points


def test_planners_are_compared_by_medians_with_failures_counted_as_more():
    def record(planner, seed, coverage, failed=False):
        path_m = [10.0 * n for n in range(len(coverage))]
        return CoverageRecord(planner, seed, coverage, path_m, 0.5, failed=failed)

    records = [
        record("quick", 1, [0.5, 0.95]),
        record("slow", 1, [0.2, 0.4, 0.6]),
        record("quick", 2, [0.5, 0.8, 0.85, 0.9]),
        record("slow", 2, [0.2, 0.4, 0.9]),
        record("quick", 3, [0.5, 0.6, 0.91]),
        record("slow", 3, [0.2, 0.4], failed=True),
    ]
    quick, slow = planner_results(records, 0.9)
    assert (quick.planner, quick.worlds, quick.reached) == ("quick", 3, 3)
    assert (quick.views, quick.fewest_views, quick.most_views) == (3, 2, 4)
    assert quick.path_m == 20.0
    assert quick.more_than_views is None
    assert (slow.views, slow.reached, slow.more_than_views, slow.path_m) == (None, 1, 3.0, None)
    lines = comparison_lines([quick, slow], 0.9)
    assert lines[1].split() == ["quick", "3", "of", "3", "3", "-", "91.0%", "20", "-"]
    assert (quick.failed, slow.failed) == (0, 1)
    assert lines[2].split()[-1] == "1"
    assert lines[2].split()[:7] == ["slow", "1", "of", "3", "more", "than", "3"]


def test_a_world_without_a_view_counts_as_failed_and_leaves_the_rest():
    """Its coverage is empty, of which the comparison took the last entry."""
    seen = CoverageRecord("p", 1, [0.5, 0.95], [0.0, 10.0], 0.5, least_clearance_m=2.0)
    none = CoverageRecord("p", 2, [], [], 0.0, refused=1, ended="refused", failed=True)
    assert (none.final_coverage, none.length_m, seen.length_m) == (0.0, 0.0, 10.0)
    (both,) = planner_results([none, seen], 0.9)
    assert (both.worlds, both.reached, both.failed, both.refused) == (2, 1, 1, 1)
    assert both.final_coverage == pytest.approx(0.475)
    assert both.least_clearance_m == 2.0
    (alone,) = planner_results([none], 0.9)
    assert (alone.final_coverage, alone.more_than_views, alone.views) == (0.0, 0.0, None)
    assert comparison_lines([alone], 0.9)[1].split()[-3:] == ["0.0%", "-", "1"]


@pytest.mark.parametrize("count", [1, 5, 6, 9, 20, 41])
def test_intervals_of_medians_are_those_of_scipys_test(count):
    values = list(np.random.default_rng(count).permutation(100)[:count])
    low, high = median_interval(values)
    expected = scipy.stats.quantile_test(values, q=0, p=0.5).confidence_interval(0.95)
    if count < 6:
        assert (low, high) == (None, None)
        assert np.isnan(expected.low)
    else:
        assert (low, high) == (expected.low, expected.high)


def test_an_interval_holds_its_median_as_often_as_it_says():
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(2000):
        low, high = median_interval(list(rng.geometric(0.01, 12)))
        assert low is not None
        assert high is not None
        held += low <= 69 <= high  # 1 - 0.99^69 = 0.5002
    assert held >= 0.94 * 2000


def test_an_end_that_no_world_reached_is_open():
    assert median_interval([3, 4, 5, 6, np.inf, np.inf]) == (3, None)


def test_scoring_two_hundred_views_is_vectorized():
    """A view is scored by a handful of array operations, however many rays and steps it has."""
    voxels = seen_wall()
    scorer = ViewScorer(voxels, CAMERA, 11.0)
    poses = np.array([T_LINK_OPTICAL] * 200)
    calls = 0

    def count(_frame, event, _argument):
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        scorer.scores(poses)
    finally:
        sys.setprofile(None)
    assert calls < 200 * 150


def test_vantage_points_have_their_target_in_the_image():
    rng = np.random.default_rng(0)
    vehicle = Vehicle(CAMERA, T_LINK_OPTICAL)
    positions, targets = rng.uniform(-10, 10, (300, 3)), rng.uniform(-10, 10, (40, 3))
    chosen, found = vantage_points(positions, targets, vehicle, rng)
    assert len(found) > 30
    for position, target in zip(positions[chosen], targets[found], strict=True):
        yaw = np.arctan2(*(target - position)[[1, 0]])
        T = np.linalg.inv(pose_to_matrix(level_pose(position, yaw)) @ T_LINK_OPTICAL)
        x, y, z = T[:3, :3] @ target + T[:3, 3]
        assert z > 0
        assert abs(x / z) < 1e-6
        assert abs(y / z) < 60 / 135


def test_unknown_planners_are_refused_with_a_list_of_names():
    with pytest.raises(InvalidInputError, match="frontier, grid, next_best_view, random"):
        make_planner("oracle")


SIZE_M = 32.0


@pytest.fixture(scope="module")
def world():
    config = {
        "seed": 4,
        "backend": "analytic",
        "stage": {
            "surroundings": "plain",
            "preset": "mountain_1",
            "extent_m": SIZE_M,
            "resolution_px": 129,
        },
        "materials": SMALL_MATERIALS,
        "assets": {"rocks": []},
        "render": {"quality": "geometry"},
        "sensors": {
            "cameras": [
                {"name": "camera", "width_px": 80, "height_px": 60, "fx_px": 67.5, "fy_px": 67.5}
            ]
        },
    }
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch()
    return simulation


def explored(simulation: Simulation, name: str, views: int):
    """Let a planner choose views; return their clearances and the share of the surface seen."""
    sensor = simulation.info().sensors[0]
    vehicle = Vehicle(sensor.intrinsics, sensor.T_base_camera, 0.8, 15.0)
    heights_m = simulation.ground_truth_mesh().vertices_m[:, 2]
    half_m = SIZE_M / 2
    bounds = Bounds(
        np.array([-half_m, -half_m, heights_m.min()]),
        np.array([half_m, half_m, heights_m.max() + 5]),
    )

    def clearance_m(points_m):
        return simulation.query_height(points_m).clearance_m

    rng = np.random.default_rng(1)
    anywhere = random_poses(bounds, vehicle, clearance_m, 150, rng)
    coverage = SurfaceCoverage(simulation.ground_truth_mesh(), vehicle, anywhere, 0.5, rng)
    start_m = np.array([-12.0, -12.0, 0.0])
    start_m[2] = simulation.query_height([start_m]).surface_height_m[0] + 2.5
    pose, planner, visited = level_pose(start_m, np.pi / 4), make_planner(name), []
    voxels = OccupancyMap(bounds, 0.5)
    voxels.set_free(start_m, 2.0)
    for _ in range(views):
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}), modalities=["depth"])
        frame = sample.frames[0]
        voxels.integrate(frame.data, frame.intrinsics, frame.T_map_camera, vehicle.max_range_m)
        visited.append(pose)
        share = coverage.add(pose)
        found = planner.next_pose(Situation(vehicle, voxels, visited, rng))
        if found is None:
            break
        pose = found
    clearances_m = clearance_m(np.array([pose.position_m for pose in visited]))
    return clearances_m, share, len(visited)


@pytest.mark.long
def test_the_next_best_view_sees_more_than_the_others_and_none_comes_near_the_ground(world):
    views = {"next_best_view": 15, "frontier": 15, "random": 15, "grid": 5}
    assert views.keys() == BUILT_IN_PLANNERS.keys()
    seen = {}
    for name, count in views.items():
        clearances_m, seen[name], _ = explored(world, name, count)
        assert clearances_m.min() > 0.8, name
    assert seen["next_best_view"] > 1.3 * seen["random"]
    assert seen["next_best_view"] > seen["frontier"]


def test_the_planner_in_the_documentation_works(world, monkeypatch):
    page = (REPOSITORY / "docs" / "exploration.md").read_text(encoding="utf-8")
    (source,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names: dict[str, Any] = {}
    exec(source, names)
    monkeypatch.setitem(BUILT_IN_PLANNERS, "upwards", names["Upwards"])
    clearances_m, share, views = explored(world, "upwards", 3)
    assert views == 3
    assert clearances_m.min() > 0.8
    assert 0 < share < 1
