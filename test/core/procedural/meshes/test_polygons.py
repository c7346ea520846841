"""Triangles of polygons, compared with the areas of these."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.procedural.meshes.polygons import PolygonError, triangulate
from oaisys_core.types import FloatArray

ANGLE = np.array([(0, 0, 0), (4, 0, 0), (4, 1, 0), (1, 1, 0), (1, 4, 0), (0, 4, 0)], float)
WITH_A_HOLE = np.array(
    [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)], float
)


def areas(points: FloatArray, counts: list[int]) -> FloatArray:
    """The areas of the triangles' sums, by polygon, all on one side."""
    corners = np.arange(len(points))
    places, polygon_of = triangulate(points, corners, np.array(counts))
    a, b, c = (points[places[:, corner]] for corner in range(3))
    crossed = np.cross(b - a, c - a)
    sums = np.bincount(polygon_of, np.linalg.norm(crossed, axis=1) / 2)
    np.testing.assert_allclose(np.linalg.norm(crossed.sum(axis=0)) / 2, sums.sum())
    return np.asarray(sums, np.float64)


@pytest.mark.parametrize("first", range(6))
@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
def test_an_angle_is_covered_whatever_its_first_corner(
    first: int, axes: tuple[int, int, int]
) -> None:
    assert areas(np.roll(ANGLE, first, axis=0)[:, axes], [6]) == pytest.approx([7.0])


@pytest.mark.parametrize("number", [4, 5, 9, 200])
def test_random_outlines_in_space_are_covered(number: int) -> None:
    random = np.random.default_rng(number)
    for _ in range(5):
        angle = np.sort(random.uniform(0, 2 * np.pi, number))
        angle = np.linspace(0, 2 * np.pi, number, endpoint=False) + 0.1 * angle / number
        radius = random.uniform(0.1, 1.0, number)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        expected = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
        R = np.linalg.qr(random.normal(size=(3, 3)))[0]
        points = np.stack((x, y, np.zeros(number)), axis=1) @ R.T + (5e5, 1e3, -20.0)
        points = np.roll(points, number // 3, axis=0)
        assert areas(points, [number])[0] == pytest.approx(expected, rel=1e-6)


def test_a_hole_that_an_edge_joins_to_the_outline_stays_open() -> None:
    points = np.column_stack((WITH_A_HOLE, np.zeros(10)))
    for first in range(10):
        assert areas(np.roll(points, first, axis=0), [10]) == pytest.approx([12.0])


def test_convex_and_concave_polygons_keep_their_order() -> None:
    square = np.array([(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)], float)
    arrow = np.array([(4, 0, 0), (1, 1, 0), (0, 4, 0), (0, 0, 0)], float)
    points = np.concatenate((square, arrow, square[:3]))
    assert areas(points, [4, 4, 3]) == pytest.approx([4.0, 4.0, 2.0])
    places, polygon_of = triangulate(points, np.arange(11), np.array([4, 4, 3]))
    assert polygon_of.tolist() == [0, 0, 1, 1, 2]
    assert places[:2].tolist() == [[0, 1, 2], [0, 2, 3]], "a fan, as ever"


def test_faces_without_an_area_are_fans() -> None:
    line = np.array([(0, 0, 0), (1, 0, 0), (3, 0, 0), (2, 0, 0)], float)
    places, _ = triangulate(line, np.array([0, 1, 2, 2, 0, 3, 1, 2]), np.array([4, 4]))
    assert len(places) == 4


@pytest.mark.parametrize("corners", [(0, 2, 1, 3), (4, 5, 6, 7, 8)], ids=["bow", "star"])
def test_a_polygon_that_crosses_itself_is_refused(corners: tuple[int, ...]) -> None:
    turn = 4 * np.pi * np.arange(5) / 5
    star = np.stack((np.cos(turn), np.sin(turn), 0 * turn), axis=1)
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
    points = np.concatenate((square, star))
    numbers = np.array([0, 1, 2, *corners])
    with pytest.raises(PolygonError, match="does not cross itself") as error:
        triangulate(points, numbers, np.array([3, len(corners)]))
    assert error.value.index == 1


def test_the_work_for_concave_polygons_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("oaisys_core.procedural.meshes.polygons.MAX_TESTS", 10)
    points = np.roll(ANGLE, 1, axis=0)
    with pytest.raises(PolygonError, match="simpler"):
        triangulate(points, np.arange(6), np.array([6]))
