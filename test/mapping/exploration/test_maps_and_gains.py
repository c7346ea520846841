"""Occupancy maps, gains and paths against closed forms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from walls import BOX, CAMERA, WALL_M, seen_wall

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, pose_to_matrix
from oaisys_mapping.exploration.gain import GainWeights, ViewScorer
from oaisys_mapping.exploration.occupancy_map import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Bounds,
    OccupancyMap,
    surface_quality,
)
from oaisys_mapping.exploration.planner import Situation, Vehicle, level_pose
from oaisys_mapping.exploration.roadmap import Roadmap


def test_a_view_frees_its_frustum_and_leaves_occluded_space_unknown():
    voxels = seen_wall()
    x, y, z = np.meshgrid(*voxels._centers(), indexing="ij")
    half_y, half_z = 80 / 135, 60 / 135
    pyramid = (abs(y) < half_y * x) & (abs(z) < half_z * x)
    clearly_in = (abs(y) < half_y * x - 0.1) & (abs(z) < half_z * x - 0.1)
    assert (voxels.state[clearly_in & (x < 7.9)] == FREE).all()
    assert (voxels.state[~pyramid & (abs(x - WALL_M) > 0.5)] == UNKNOWN).all()
    assert (voxels.state[x > WALL_M + 0.5] == UNKNOWN).all()
    wall = clearly_in & (x == 8.25)
    assert (voxels.state[wall] == OCCUPIED).all()
    # The wall faces the camera: the cosine of the angle of incidence is x over the distance.
    points = np.column_stack((x[wall], y[wall], z[wall]))
    distances = np.linalg.norm(points, axis=1)
    expected = surface_quality(distances, WALL_M / distances)
    # The best point of a voxel counts, not its middle.
    better = voxels.quality[wall] - expected
    assert better.min() > -0.01
    assert better.max() < 0.09
    normals = voxels.normals[wall] / np.linalg.norm(voxels.normals[wall], axis=1, keepdims=True)
    np.testing.assert_allclose(normals, np.tile([-1.0, 0, 0], (wall.sum(), 1)), atol=1e-3)


def test_the_frontier_is_where_the_observed_wall_ends():
    frontier = seen_wall().surface_frontier()
    x, y, z = np.argwhere(frontier).T
    assert len(x)
    centers = BOX.low_m + (np.column_stack((x, y, z)) + 0.5) * 0.5
    assert (abs(centers[:, 0] - WALL_M) < 1.0).all()
    border = np.maximum(
        abs(centers[:, 1]) - 80 / 135 * WALL_M, abs(centers[:, 2]) - 60 / 135 * WALL_M
    )
    assert (abs(border) < 1.2).all()


def test_infinite_depth_frees_up_to_the_range_and_nan_is_ignored():
    for depth, state in ((np.inf, FREE), (np.nan, UNKNOWN)):
        voxels = OccupancyMap(BOX, 0.5)
        depth_m = np.full((120, 160), depth, np.float32)
        voxels.integrate(depth_m, CAMERA, T_LINK_OPTICAL, 5.0)
        assert voxels.state[9, 12, 12] == state
        assert (voxels.state[11:] == UNKNOWN).all()


def test_occupied_voxels_stay_occupied():
    voxels = seen_wall()
    occupied = voxels.state == OCCUPIED
    voxels.integrate(np.full((120, 160), np.inf, np.float32), CAMERA, T_LINK_OPTICAL, 20.0)
    assert (voxels.state[occupied] == OCCUPIED).all()


@pytest.mark.parametrize(("bounds", "voxel_size_m"), [(BOX, 0.0), (BOX, np.nan), (BOX, 0.001)])
def test_maps_of_impossible_size_are_refused(bounds, voxel_size_m):
    with pytest.raises(InvalidInputError, match="voxel_size_m"):
        OccupancyMap(bounds, voxel_size_m)


def test_the_gain_of_an_unknown_pyramid_is_its_volume():
    voxels = OccupancyMap(Bounds(np.full(3, -15.0), np.full(3, 15.0)), 0.25)
    scorer = ViewScorer(voxels, CAMERA, 10.0, GainWeights(frontier=0, unknown=1, surface=0))
    # Base area at depth 1 times depth cubed over three.
    expected_m3 = 160 / 135 * 120 / 135 * 10.0**3 / 3
    poses = [np.eye(4), T_LINK_OPTICAL, pose_to_matrix(level_pose(np.zeros(3), 0.7))]
    np.testing.assert_allclose(scorer.scores(np.array(poses)), expected_m3, rtol=0.01)


def test_a_known_wall_hides_the_volume_behind_it():
    scorer = ViewScorer(seen_wall(), CAMERA, 11.0, GainWeights(frontier=0, unknown=1, surface=0))
    towards, away = scorer.scores(
        np.array([T_LINK_OPTICAL, pose_to_matrix(level_pose([4, 0, 0], np.pi)) @ T_LINK_OPTICAL])
    )
    assert towards < 0.05 * 160 / 135 * 120 / 135 * 11.0**3 / 3
    assert away > 1.0


def test_a_better_view_of_a_known_surface_gains_its_area_times_the_quality():
    voxels = seen_wall()
    voxels.quality[:] = 0
    scorer = ViewScorer(voxels, CAMERA, 11.0, GainWeights(frontier=0, unknown=0, surface=1))
    pose = pose_to_matrix(level_pose([3.0, 0, 0], 0.0)) @ T_LINK_OPTICAL
    area_m2 = 160 / 135 * 120 / 135 * (WALL_M - 3) ** 2
    # The quality is 1 straight ahead and falls to 0.8 in the corners.
    assert 0.85 * area_m2 < scorer.scores(pose[None])[0] < 1.1 * area_m2


def free_box_with_a_wall(gap: bool) -> OccupancyMap:
    voxels = OccupancyMap(Bounds(np.zeros(3), np.array([12.0, 12.0, 4.0])), 0.5)
    voxels.state[:] = FREE
    voxels.state[12, : 16 if gap else None] = OCCUPIED
    return voxels


def test_paths_lead_around_walls():
    rng = np.random.default_rng(3)
    start, goal = np.array([3.0, 2.0, 2.0]), np.array([9.0, 2.0, 2.0])
    for gap in (True, False):
        voxels = free_box_with_a_wall(gap)
        clearance_m = voxels.clearance_m()
        places = rng.uniform(0.5, [11.5, 11.5, 3.5], (400, 3))
        cells, _ = voxels.indices(places)
        places = places[clearance_m[tuple(cells.T)] >= 0.5]
        roadmap = Roadmap(voxels, clearance_m, 0.5, start, np.vstack((goal, places)))
        length_m = roadmap.lengths_m[0]
        if not gap:
            assert np.isinf(length_m)
            continue
        # Around the wall's end at y = 8, half a metre away from it.
        shortest_m = 2 * np.hypot(3, 6)
        assert shortest_m < length_m < 1.35 * shortest_m
        way_m = roadmap.path_m(0)
        np.testing.assert_allclose(way_m[[0, -1]], [start, goal])
        np.testing.assert_allclose(np.linalg.norm(np.diff(way_m, axis=0), axis=1).sum(), length_m)
        crossing = [
            a[1] + (6.25 - a[0]) / (b[0] - a[0]) * (b[1] - a[1])
            for a, b in pairwise(way_m)
            if (a[0] - 6.25) * (b[0] - 6.25) < 0
        ]
        assert crossing
        assert min(crossing) > 8.0


def test_a_vehicle_too_near_to_a_surface_may_leave_but_not_approach_another():
    start, goal = np.array([3.0, 2.0, 2.0]), np.array([9.0, 2.0, 2.0])
    voxels = free_box_with_a_wall(gap=True)
    voxels.state[6, 5, 4] = OCCUPIED  # half a metre from the start
    clearance_m = voxels.clearance_m()
    aside = np.array([1.5, 2.0, 2.0])
    roadmap = Roadmap(voxels, clearance_m, 1.0, start, np.vstack((aside, goal)))
    assert np.isfinite(roadmap.lengths_m[0])
    assert np.isinf(roadmap.lengths_m[1])


def test_the_path_to_a_pose_is_the_one_that_the_planner_used():
    voxels = free_box_with_a_wall(gap=True)
    rng = np.random.default_rng(3)
    vehicle = Vehicle(CAMERA, T_LINK_OPTICAL, 0.5)
    visited = [level_pose((3.0, 2.0, 2.0), 0.0)]
    situation = Situation(vehicle, voxels, visited, rng)
    behind = np.array([9.25, 2.25, 2.25])
    positions_m = np.vstack((situation.random_positions(500), behind))
    lengths_m = situation.roadmap(positions_m).lengths_m
    way_m = situation.path_m(behind)
    assert way_m is not None
    np.testing.assert_allclose(way_m[[0, -1]], [situation.here_m, behind])
    flown_m = np.linalg.norm(np.diff(way_m, axis=0), axis=1).sum()
    np.testing.assert_allclose(flown_m, lengths_m[-1])
    # Another place, that nobody asked about: a way is looked for.
    other = Situation(vehicle, voxels, visited, rng).path_m(behind)
    assert other is not None
    np.testing.assert_allclose(other[[0, -1]], [situation.here_m, behind])
    voxels.state[12] = OCCUPIED
    assert Situation(vehicle, voxels, visited, rng).path_m(behind) is None
