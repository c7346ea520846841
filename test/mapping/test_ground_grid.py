"""Grids of the ground against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.types import TriangleMesh
from oaisys_mapping.ground_grid import GridPlace, GroundGrid, Rover, grid_of_points, ground_layers
from oaisys_mapping.surface_labels import labels_at

ROVER = Rover(clearance_m=0.3, max_slope_rad=0.5, radius_m=0.5)


def place() -> GridPlace:
    return GridPlace.around((3.14, -2.72), 8.0, 0.2)


def test_cells_of_all_grids_coincide_and_the_place_is_in_the_middle_one() -> None:
    for xy_m in ((3.14, -2.72), (0.0, 0.0), (-100.03, 7.99)):
        grid = GridPlace.around(xy_m, 8.0, 0.2)
        assert grid.count == 40
        low_x, low_y, high_x, high_y = grid.extent_m
        np.testing.assert_allclose(np.array(grid.min_xy_m) / 0.2 % 1 % 1.0, 0, atol=1e-9)
        np.testing.assert_allclose(((low_x + high_x) / 2, (low_y + high_y) / 2), xy_m, atol=0.11)
        assert (high_x - low_x, high_y - low_y) == pytest.approx((8.0, 8.0))


def test_a_tilted_plane_has_its_slope_and_no_roughness() -> None:
    x_m, y_m = np.moveaxis(place().centres_m(), -1, 0)
    heights_m = (1000.0 + 0.3 * x_m - 0.1 * y_m).astype(np.float32)
    layers = ground_layers(GroundGrid(place(), heights_m), ROVER)
    slope_rad = np.arctan(np.hypot(0.3, 0.1))
    np.testing.assert_allclose(layers["slope"], slope_rad, atol=1e-3)
    assert layers["roughness"].max() < 1e-3
    np.testing.assert_allclose(layers["traversability"], 1 - slope_rad / 0.5, atol=3e-3)
    assert list(layers) == ["elevation", "slope", "roughness", "step", "traversability"]


def test_a_stone_stops_a_rover_that_cannot_pass_over_it() -> None:
    heights_m = np.zeros((40, 40), np.float32)
    heights_m[20, 10] = 0.5
    heights_m[20, 30] = 0.1
    heights_m[0, 0] = np.nan
    classes = np.full((40, 40), 7, np.uint16)
    layers = ground_layers(GroundGrid(place(), heights_m, classes), ROVER)
    passable = layers["traversability"]
    assert passable[20, 10] == passable[21, 11] == 0.0
    assert 0.3 < passable[20, 30] < 1.0
    assert passable[5, 5] == 1.0
    for layer in layers.values():
        assert np.isnan(layer[0, 0])
        assert np.isfinite(layer).sum() == 40 * 40 - 1
    assert (layers["class"][1:] == 7).all()


def test_a_single_known_cell_has_no_slope() -> None:
    heights_m = np.full((40, 40), np.nan, np.float32)
    heights_m[20, 20] = 3.0
    layers = ground_layers(GroundGrid(place(), heights_m), ROVER)
    assert layers["elevation"][20, 20] == 3.0
    assert np.isnan(layers["slope"]).all()
    assert np.isnan(layers["traversability"]).all()


def test_points_become_the_topmost_surface_of_their_cells() -> None:
    x_m, y_m = 3.05, -2.65
    points_m = np.array([(x_m, y_m, 1.0), (x_m, y_m, 1.1), (x_m, y_m, -3.0), (99.0, 0.0, 5.0)])
    grid = grid_of_points(place(), points_m, np.array([1, 2, 3, 4], np.uint16))
    known = np.argwhere(np.isfinite(grid.elevation_m))
    ((row, column),) = known.tolist()
    assert grid.elevation_m[row, column] == pytest.approx(1.05)
    assert grid.class_ids is not None
    assert grid.class_ids[row, column] == 2
    np.testing.assert_allclose(place().centres_m()[row, column], (x_m, y_m), atol=0.1)


def test_labels_of_large_and_small_triangles_are_found() -> None:
    vertices_m = np.array(
        [(0, 0, 0), (10, 0, 0), (0, 10, 0), (10, 10, 0), (1, 1, 2), (2, 1, 2), (1, 2, 2)]
    )
    triangles = np.array([(0, 1, 2), (1, 3, 2), (4, 5, 6)], np.int32)
    mesh = TriangleMesh(vertices_m.astype(float), triangles, np.array([5, 6, 9], np.uint16))
    points_m = np.array([(1, 1, 0), (4.4, 5, 0), (5.6, 5, 0), (1.2, 1.2, 2), (np.nan, 0, 0)])
    assert labels_at(mesh, points_m, 0.1).tolist() == [5, 5, 6, 9, 0]
