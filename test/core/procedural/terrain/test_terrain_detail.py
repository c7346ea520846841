"""Finer ground near the cameras: one surface without gaps, whatever asks for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from oaisys_core.procedural.terrain.detail import Detail, Patch, add_detail, patch_at
from oaisys_core.procedural.terrain.displacement import LayerRelief, displace
from oaisys_core.scene import HeightField, PbrMaps, TerrainLayer, TerrainMaterial

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


TILE_M, RELIEF_M = 1.0, 0.08


def waves(ground: HeightField, *, projects_sides: bool = False) -> LayerRelief:
    """Return the relief of a texture of one wave a tile along x."""
    x = (np.arange(256) + 0.5) / 256
    wave = np.tile(0.5 + 0.5 * np.sin(2 * np.pi * x), (256, 1)).astype(np.float32)
    flat = np.full((256, 256, 3), 128, np.uint8)
    maps = PbrMaps("waves", flat, wave, flat, flat[..., 0], TILE_M)
    masks, layer = np.ones((1, 4, 4), np.float32), TerrainLayer("waves", (1,), maps)
    material = TerrainMaterial((layer,), masks, ground.extent_m, projects_sides=projects_sides)
    return LayerRelief(material, (RELIEF_M,))


def plain(size: int = 65) -> HeightField:
    return HeightField(np.zeros((size, size), np.float32), (-16, -16), 0.5)


BARE = Detail(seed=1, radius_m=4.0, spacing_m=0.02, amplitude_m=0.0, gain=0.5, below_m=9.0)


def test_textures_raise_the_ground_by_their_relief_and_fade_out() -> None:
    ground = plain()
    detail = replace(BARE, relief=waves(ground))
    fine = add_detail(ground, detail, patch_at(ground, detail, (0, 0)))
    xy = np.random.default_rng(2).uniform(-2, 2, (2000, 2))
    exact = RELIEF_M / 2 * np.sin(2 * np.pi * xy[:, 0] / TILE_M)
    assert np.abs(fine.height_at(xy) - exact).max() < 3e-4
    rim = np.column_stack((np.full(200, 3.999), np.linspace(-4, 4, 200)))
    assert np.abs(fine.height_at(rim)).max() < 1e-5


def test_what_the_coarse_ground_shows_is_not_raised_twice() -> None:
    ground = HeightField(np.zeros((257, 257), np.float32), (-16, -16), 0.125)
    relief = waves(ground)
    raised = displace(ground, relief)
    detail = replace(BARE, relief=relief, shown=relief)
    fine = add_detail(raised, detail, patch_at(raised, detail, (0, 0)))
    xy = np.random.default_rng(2).uniform(-2, 2, (2000, 2))
    exact = RELIEF_M / 2 * np.sin(2 * np.pi * xy[:, 0] / TILE_M)
    assert np.abs(fine.height_at(xy) - exact).max() < 1e-3
    assert np.abs(raised.height_at(xy) - exact).max() > 3e-3


def test_steep_ground_with_textures_from_the_side_keeps_its_shape() -> None:
    x = np.linspace(-16, 16, 65)
    cliff = HeightField(np.tile(1.2 * x, (65, 1)).astype(np.float32), (-16, -16), 0.5)
    detail = replace(BARE, relief=waves(cliff, projects_sides=True))
    fine = add_detail(cliff, detail, patch_at(cliff, detail, (0, 0)))
    xy = np.random.default_rng(2).uniform(-2, 2, (500, 2))
    assert fine.height_at(xy) == pytest.approx(1.2 * xy[:, 0], abs=1e-5)


def test_colour_has_the_normals_of_the_ground_without_its_textures() -> None:
    ground = plain()
    assert add_detail(ground, BARE, patch_at(ground, BARE, (0, 0))).shading_normals() is None
    detail = replace(BARE, relief=waves(ground))
    fine = add_detail(ground, detail, patch_at(ground, detail, (0, 0)))
    normals = fine.shading_normals()
    assert normals is not None
    assert normals.shape == fine.vertices_m().shape
    assert np.allclose(normals, (0, 0, 1))
    slope = HeightField(
        np.tile(np.linspace(-16, 16, 65), (65, 1)).astype(np.float32), (-16, -16), 0.5
    )
    raised = add_detail(slope, detail, patch_at(slope, detail, (0, 0)))
    assert raised.shading_normals() == pytest.approx(
        np.tile((-np.sqrt(0.5), 0, np.sqrt(0.5)), (len(raised.vertices_m()), 1)), abs=1e-4
    )


def test_cameras_high_above_have_no_use_for_it() -> None:
    ground = hills()
    near = DETAIL.around(ground, None, np.array([(0.0, 0.0, 5.0), (0.2, 0.0, 5.0)]))
    assert near is not None
    again = DETAIL.around(ground, near, np.array([(0.1, 0.1, 9.0)]))
    assert again is near
    assert DETAIL.around(ground, near, np.array([(0.0, 0.0, 40.0)])) is None
    assert DETAIL.around(ground, near, np.array([(99.0, 0.0, 2.0)])) is None
