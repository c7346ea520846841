"""Finer ground near the cameras: one surface without gaps, whatever asks for it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from oaisys_core.procedural.terrain.detail import Detail, Patch, add_detail, patch_at
from oaisys_core.scene import HeightField

DETAIL = Detail(seed=3, radius_m=2.0, spacing_m=0.1, amplitude_m=0.05, gain=0.6, below_m=20.0)


def hills(size: int = 33) -> HeightField:
    rng = np.random.default_rng(5)
    return HeightField(rng.normal(scale=0.3, size=(size, size)).astype(np.float32), (-8, -8), 0.5)


PLACES = [(0.3, -0.4), (-8.0, 8.0), (7.9, 0.0), (-7.4, -7.4), (3.0, -30.0)]


@pytest.mark.parametrize("place", PLACES)
def test_the_surface_has_no_gap(place: tuple[float, float]) -> None:
    ground = hills()
    fine = add_detail(ground, DETAIL, patch_at(ground, DETAIL, place))
    mesh = trimesh.Trimesh(fine.vertices_m(), fine.triangles(), process=False)
    edges, count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    assert set(count) == {1, 2}
    x, y = np.moveaxis(fine.vertices_m()[edges[count == 1]][..., :2], -1, 0)
    on_border = [np.isclose(np.abs(axis), 8.0).all(axis=1) for axis in (x, y)]
    assert (on_border[0] | on_border[1]).all(), "edges of one triangle lie on the stage's border"
    assert len(np.unique(fine.triangles())) == len(fine.vertices_m()), "no loose vertices"
    assert (mesh.face_normals[:, 2] > 0).all()
    assert mesh.area_faces.min() > 0
    area = np.abs(mesh.face_normals[:, 2]) @ mesh.area_faces
    assert area == pytest.approx(16.0 * 16.0, rel=1e-5)


@pytest.mark.parametrize("place", PLACES)
def test_heights_are_those_of_the_triangles(place: tuple[float, float]) -> None:
    ground = hills()
    fine = add_detail(ground, DETAIL, patch_at(ground, DETAIL, place))
    corners = fine.vertices_m()[fine.triangles()].astype(float)
    weights = np.random.default_rng(1).dirichlet(np.ones(3), len(corners))
    points = np.einsum("tc,tcx->tx", weights, corners)
    assert np.allclose(fine.height_at(points[:, :2]), points[:, 2], atol=2e-6)
    assert np.isnan(fine.height_at([(9.0, 0.0)])).all()


def test_far_from_the_cameras_nothing_changes() -> None:
    ground = hills()
    fine = add_detail(ground, DETAIL, patch_at(ground, DETAIL, (0, 0)))
    xy = np.random.default_rng(2).uniform(-8, 8, (5000, 2))
    far = np.abs(xy).max(axis=1) > 2.01
    assert (fine.height_at(xy[far]) == ground.height_at(xy[far])).all()
    near = np.abs(xy).max(axis=1) < 1.0
    change = fine.height_at(xy[near]) - ground.height_at(xy[near])
    assert change.std() > 0.01


def test_the_patch_depends_on_the_place_alone_and_moves_in_steps() -> None:
    ground = hills()
    assert patch_at(ground, DETAIL, (0.3, 0.3)) == patch_at(ground, DETAIL, (-0.3, -0.3))
    assert patch_at(ground, DETAIL, (0.3, 0.3)) == Patch(12, 20, 12, 20)
    assert patch_at(ground, DETAIL, (1.3, 0.3)) == Patch(12, 20, 14, 22)
    assert patch_at(ground, DETAIL, (99.0, -99.0)) == Patch(0, 8, 24, 32)


def test_the_noise_is_fixed_to_the_world() -> None:
    ground = HeightField(np.zeros((65, 65), np.float32), (-16, -16), 0.5)
    one = add_detail(ground, DETAIL, Patch(20, 40, 20, 40))
    other = add_detail(ground, DETAIL, Patch(22, 42, 20, 40))
    xy = np.random.default_rng(2).uniform(-2.0, 0.0, (1000, 2))
    assert np.allclose(one.height_at(xy), other.height_at(xy), atol=1e-6)
    assert np.abs(one.height_at(xy)).max() > 0.005


def test_without_noise_the_ground_becomes_smooth() -> None:
    x = np.linspace(-8, 8, 33)
    bowl = HeightField(np.add.outer(x**2, x**2).astype(np.float32) / 20, (-8.0, -8.0), 0.5)
    smooth = Detail(seed=1, radius_m=4.0, spacing_m=0.05, amplitude_m=0.0, gain=0.5, below_m=9.0)
    fine = add_detail(bowl, smooth, patch_at(bowl, smooth, (0, 0)))
    xy = np.random.default_rng(2).uniform(-2, 2, (2000, 2))
    exact = (xy**2).sum(axis=1) / 20
    assert np.abs(fine.height_at(xy) - exact).max() < 2e-4
    assert np.abs(bowl.height_at(xy) - exact).max() > 3e-3


def test_cameras_high_above_have_no_use_for_it() -> None:
    ground = hills()
    near = DETAIL.around(ground, None, np.array([(0.0, 0.0, 5.0), (0.2, 0.0, 5.0)]))
    assert near is not None
    again = DETAIL.around(ground, near, np.array([(0.1, 0.1, 9.0)]))
    assert again is near
    assert DETAIL.around(ground, near, np.array([(0.0, 0.0, 40.0)])) is None
    assert DETAIL.around(ground, near, np.array([(99.0, 0.0, 2.0)])) is None
