"""Triangles that a part of an image can show."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oaisys_core.verification import triangle_groups
from oaisys_core.verification.triangle_groups import TriangleGroups

OBJECTS, EACH = 300, 20


def objects(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return vertices and triangles of small objects all around the origin."""
    middles_m = rng.uniform(-20, 20, (OBJECTS, 1, 3))
    vertices_m = middles_m + rng.normal(scale=0.4, size=(OBJECTS, 3 * EACH, 3))
    return vertices_m.reshape(-1, 3), np.arange(OBJECTS * EACH * 3, dtype=np.int32).reshape(-1, 3)


@pytest.mark.parametrize("most", [7, 2048])
@pytest.mark.parametrize("at_once", [100, 1_000_000])
def test_all_that_is_in_a_part_of_the_image_is_among_those_seen(
    monkeypatch: pytest.MonkeyPatch, most: int, at_once: int
) -> None:
    """Points of triangles are projected one by one; most triangles elsewhere are left out."""
    monkeypatch.setattr(triangle_groups, "MAX_TRIANGLES", most)
    monkeypatch.setattr(triangle_groups, "TRIANGLES_AT_ONCE", at_once)
    rng = np.random.default_rng(4)
    vertices_m, triangles = objects(rng)
    ids = np.repeat(np.arange(OBJECTS, dtype=np.uint32), EACH)
    groups = TriangleGroups(vertices_m, triangles, ids)
    shares = rng.dirichlet((1, 1, 1), 50)
    boxes = [np.array((-0.3, -0.2, -0.1, 0.0)), np.array((0.4, 0.1, 0.5, 0.3))]
    for R in Rotation.random(10, random_state=6).as_matrix():
        origin_m = rng.uniform(-5, 5, 3)
        seen = groups.visible_in(R, origin_m, boxes)

        points_m = np.einsum("sk,tkd->tsd", shares, vertices_m[triangles]) - origin_m
        x, y, z = np.moveaxis(points_m @ R, -1, 0)
        inside = np.zeros(x.shape, bool)
        for x0, y0, x1, y1 in boxes:
            inside |= (x >= x0 * z) & (x <= x1 * z) & (y >= y0 * z) & (y <= y1 * z) & (z > 0)
        in_image = np.flatnonzero(inside.any(axis=1))
        assert len(in_image) > 0
        assert np.isin(in_image, seen).all()
        assert len(np.unique(seen)) == len(seen) < 0.2 * len(triangles)


def test_nothing_is_seen_where_everything_is_behind() -> None:
    vertices_m = np.array(((0, 0, -1), (1, 0, -1), (0, 1, -1)), float)
    groups = TriangleGroups(vertices_m, np.array([[0, 1, 2]], np.int32), np.zeros(1, np.uint32))

    assert len(groups.visible_in(np.eye(3), np.zeros(3), [np.array((-1, -1, 1, 1))])) == 0
