"""Cells that divide a tile, and how far their borders are."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from oaisys_core.procedural.textures import cells

SIZE = 128


def test_unbent_cells_are_a_voronoi_diagram() -> None:
    rng = np.random.default_rng(1)
    ids = cells.voronoi(SIZE, 5, rng, warp=0.0, jitter=0.3)
    # The same draws give the centres; scipy finds the nearest one on the torus.
    offset = 0.5 + np.random.default_rng(1).uniform(-0.3, 0.3, (2, 25))
    row, column = np.divmod(np.arange(25), 5)
    centres = np.stack((column + offset[0], row + offset[1]), axis=1) * (SIZE / 5)
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    _, nearest = cKDTree(centres, boxsize=SIZE).query(np.stack((x.ravel(), y.ravel()), axis=1))
    assert (ids.ravel() == nearest).mean() > 0.999


def test_border_distance_goes_around_the_tile() -> None:
    ids = cells.voronoi(SIZE, 4, np.random.default_rng(2))
    distance = cells.border_distance(ids)
    border = (ids != np.roll(ids, 1, 0)) | (ids != np.roll(ids, 1, 1))
    tiled = distance_transform_edt(~np.tile(border, (3, 3)))[SIZE : 2 * SIZE, SIZE : 2 * SIZE]
    # OpenCV's 5 x 5 chamfer distance is within 3 % of Euclid's.
    assert np.allclose(distance, tiled, rtol=0.03, atol=0.3)


def test_borders_count_only_where_they_are_kept() -> None:
    ids = (np.mgrid[:SIZE, :SIZE][1] >= SIZE // 2).astype(np.int64)
    keep = np.zeros(ids.shape, bool)
    assert (cells.border_distance(ids, keep) >= SIZE).all()
    keep[:, SIZE // 4 : SIZE * 3 // 4] = True
    assert cells.border_distance(ids, keep)[0, 0] == pytest.approx(SIZE / 2, rel=0.03)


def test_places_are_measured_from_the_middle_of_a_cell() -> None:
    # Four squares, shifted so that they lie across the tile's edges.
    y, x = (np.mgrid[:SIZE, :SIZE] + SIZE // 4) % SIZE // (SIZE // 2)
    ids = (2 * y + x).astype(np.int64)
    across, down = cells.from_centre(ids)
    for field in (across, down):
        assert np.abs(field).max() == pytest.approx(0.25, abs=1 / SIZE)
        for number in range(4):
            assert field[ids == number].mean() == pytest.approx(0, abs=1e-4)
    assert across[0, SIZE // 4 - 1] > 0.24
    assert across[0, SIZE // 4] < -0.24


def test_tilted_cells_are_planes() -> None:
    ids = cells.voronoi(SIZE, 3, np.random.default_rng(3))
    height = cells.facet_heights(ids, np.random.default_rng(4))
    inside = cells.border_distance(ids) > 3
    bend = np.roll(height, 1, 1) - 2 * height + np.roll(height, -1, 1)
    assert np.abs(bend[inside]).max() < 1e-5
    assert height.std() > 0.01
