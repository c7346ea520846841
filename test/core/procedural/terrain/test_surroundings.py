"""Land around a stage: it joins the stage, has its relief, and curves as a body does."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.mesh_ground import MeshGround
from oaisys_core.procedural.terrain.presets import make_ground
from oaisys_core.procedural.terrain.surroundings.far_ground import FarGroundMesh
from oaisys_core.procedural.terrain.surroundings.kinds import EARTH_RADIUS_M, Surroundings
from oaisys_core.procedural.terrain.surroundings.land import land_around
from oaisys_core.procedural.terrain.surroundings.plain import EDGE_POINTS, plain_around
from oaisys_core.procedural.terrain.surroundings.spectrum import longer_octaves, own_octaves
from oaisys_core.scene import HeightField

EXTENT_M = 60.0


def stage(preset: str = "mounds", size_px: int = 129) -> HeightField:
    return make_ground(preset, EXTENT_M, size_px, np.random.default_rng(2))


def oblong() -> HeightField:
    """A stage whose sides have lengths that are no multiples of each other."""
    x, y = np.arange(41) * 0.7, np.arange(74)[:, None] * 0.7
    return HeightField((np.sin(x / 3) + np.cos(y / 5)).astype(np.float32), (-9.0, 4.0), 0.7)


def of_land(land: FarGroundMesh) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and triangles without the wall below the stage's edge."""
    assert isinstance(land.stage, HeightField)
    wall = 2 * len(rim(land.stage))
    return land.vertices_m[:-wall].astype(np.float64), land.triangles[:-wall]


def rim(ground: HeightField) -> NDArray[np.float32]:
    rows, cols = ground.elevation_m.shape
    grid = ground.vertices_m().reshape(rows, cols, 3)
    sides = (grid[0, :-1], grid[:-1, -1], grid[-1, :0:-1], grid[:0:-1, 0])
    return np.concatenate(sides)


@pytest.mark.parametrize("ground", [stage(), stage("canyon", 200), oblong()])
def test_land_begins_with_the_stages_own_edge_and_has_no_gap(ground: HeightField) -> None:
    land = land_around(ground, 5, EARTH_RADIUS_M)
    edge = rim(ground)
    np.testing.assert_array_equal(land.vertices_m[: len(edge)], edge)

    vertices_m, triangles = of_land(land)
    edges = np.concatenate([triangles[:, (a, b)] for a, b in ((0, 1), (1, 2), (2, 0))])
    pairs, counts = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    assert counts.max() == 2
    # Only the stage's edge and the outer rim, a loop each, are edges of a single triangle.
    open_pairs = pairs[counts == 1]
    inner = open_pairs[(open_pairs < len(edge)).all(axis=1)]
    assert len(inner) == len(edge)
    outer = np.unique(open_pairs[(open_pairs >= len(edge)).all(axis=1)])
    assert len(inner) + len(outer) == len(open_pairs)
    reach_m = np.abs(vertices_m[outer, :2]).max(axis=1)
    assert reach_m.min() > 0.99 * np.abs(vertices_m[:, :2]).max()

    a, b, c = (vertices_m[triangles[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    assert area.min() > 0
    x0, y0, x1, y1 = ground.extent_m
    width_m, depth_m = np.ptp(vertices_m[:, :2], axis=0)
    assert area.sum() / 2 == pytest.approx(width_m * depth_m - (x1 - x0) * (y1 - y0), rel=1e-6)
    assert len(land.vertices_m) <= 100_000


def test_land_is_lowered_by_the_square_of_the_distance_over_the_diameter() -> None:
    ground = stage()
    earth, moon = (land_around(ground, 5, radius) for radius in (6.371e6, 1.7374e6))
    common = 58_000
    np.testing.assert_array_equal(earth.vertices_m[:common, :2], moon.vertices_m[:common, :2])
    xy_m = earth.vertices_m[:common, :2].astype(np.float64)
    outside_m = np.maximum(np.abs(xy_m) - EXTENT_M / 2, 0)
    squared = (outside_m**2).sum(axis=1)
    assert squared.max() > 2e7
    between_m = earth.vertices_m[:common, 2] - moon.vertices_m[:common, 2]
    expected_m = squared / (2 * 1.7374e6) - squared / (2 * 6.371e6)
    np.testing.assert_allclose(between_m, expected_m, rtol=1e-3, atol=1e-3)


def test_land_has_a_seed_and_nothing_else_changes_it() -> None:
    ground = stage()
    land = Surroundings("land", 5).around(ground, None)
    again = Surroundings("land", 5).around(stage(), None)
    np.testing.assert_array_equal(again.vertices_m, land.vertices_m)
    np.testing.assert_array_equal(again.triangles, land.triangles)
    other = Surroundings("land", 6).around(ground, None)
    assert np.abs(other.vertices_m[:, 2] - land.vertices_m[:, 2]).max() > 1.0
    count = len(of_land(land)[0])
    elsewhere = Surroundings("land", 5).around(stage("dunes"), None).vertices_m[:count, 2]
    far = np.abs(land.vertices_m[:count, 0] - 3000) < 2000
    assert np.corrcoef(elsewhere[far], land.vertices_m[:count, 2][far])[0, 1] < 0.9
    assert Surroundings("land", 5).around(ground, land) is land
    flat = make_ground("plane", EXTENT_M, 33, np.random.default_rng(2))
    assert not Surroundings("land", 5).around(flat, None).is_land


def test_land_goes_on_with_the_stages_slope() -> None:
    """Just beyond the edge, a smooth stage and its land have the same heights and slopes."""
    at = np.linspace(-30, 30, 301)
    smooth_m = 0.1 * at[None, :] + 1.5 * np.sin(at / 9)[:, None]
    ground = HeightField(smooth_m.astype(np.float32), (-30.0, -30.0), 0.2)
    land = land_around(ground, 5, EARTH_RADIUS_M)
    y = np.linspace(-20, 20, 40)
    beyond_m = land.height_at(np.column_stack((np.full(40, 30.5), y)))
    expected_m = 0.1 * 30.5 + 1.5 * np.sin(y / 9)
    np.testing.assert_allclose(beyond_m, expected_m, atol=0.05)


def test_heights_are_those_of_the_vertices_and_nan_on_the_stage() -> None:
    land = land_around(stage(), 5, EARTH_RADIUS_M)
    vertices_m, _ = of_land(land)
    some = vertices_m[len(rim(stage())) :: 977]
    some = some[np.abs(some[:, :2]).max(axis=1) < 1e5]
    np.testing.assert_allclose(land.height_at(some[:, :2]), some[:, 2], rtol=1e-5, atol=1e-2)
    assert np.isnan(land.height_at([(0.0, 0.0), (29.9, -29.9)])).all()


def test_the_spectrum_of_a_wave_is_at_its_wavelength() -> None:
    x = np.arange(512) * 0.25
    wave_m = 0.8 * np.sin(2 * np.pi * x / 12.0)
    ground = HeightField(np.tile(wave_m, (512, 1)).astype(np.float32), (0.0, 0.0), 0.25)
    own = own_octaves(ground)
    octaves = [o for o in [*own, *longer_octaves(own, 1e4)] if o.wavelength_m < 64]
    strongest = max(octaves, key=lambda octave: octave.deviation_m)
    assert 12.0 / 2**0.5 < strongest.wavelength_m <= 12.0 * 2**0.5
    total = sum(octave.deviation_m**2 for octave in octaves)
    assert total == pytest.approx(wave_m.var(), rel=0.3)
    shortest = octaves[0]
    assert shortest.wavelength_m < 1
    assert shortest.deviation_m < 0.01


def test_longer_forms_are_neither_level_nor_steep() -> None:
    for preset in ("mounds", "canyon", "dunes"):
        longer = [
            o for o in longer_octaves(own_octaves(stage(preset)), 4e4) if o.wavelength_m > 5000
        ]
        assert len(longer) >= 3
        for octave in longer:
            assert 0.011 - 1e-9 <= octave.deviation_m / octave.wavelength_m <= 0.015 + 1e-9


def test_land_surrounds_a_mesh_with_holes_in_its_edge() -> None:
    t = np.linspace(-20, 20, 41)
    x, y = np.meshgrid(t, t)
    z = 0.3 * np.sin(x) * np.cos(y / 3)
    points = np.column_stack((x.ravel(), y.ravel(), z.ravel())).astype(np.float32)
    whole = HeightField(z.astype(np.float32), (-20.0, -20.0), 1.0).triangles()
    missing = (points[whole, 0].min(axis=1) > 15) & (points[whole, 1].min(axis=1) > 15)
    land = land_around(MeshGround(points, whole[~missing]), 5, EARTH_RADIUS_M)
    assert np.isfinite(land.vertices_m).all()
    heights_m = land.height_at([(20.5, 0.0), (20.5, 18.0), (0.0, -20.5)])
    assert np.abs(heights_m).max() < 1.0


def test_a_level_plain_looks_level_at_the_stages_edge() -> None:
    flat = HeightField(np.zeros((33, 33), np.float32), (-8.0, -8.0), 0.5)
    plain = plain_around(flat)
    mesh = trimesh.Trimesh(plain.vertices_m, plain.triangles, process=False)
    on_surface = plain.vertices_m[:, 2] == 0
    used = on_surface & np.isin(
        np.arange(len(on_surface)), plain.triangles[mesh.face_normals[:, 2] > 0.99]
    )
    np.testing.assert_allclose(mesh.vertex_normals[used], [(0, 0, 1)] * used.sum(), atol=1e-6)
    reach_m = np.abs(plain.vertices_m[used][:, :2]).max(axis=1)
    assert reach_m.min() == pytest.approx(8.0), "the plain begins at the stage's edge"


@pytest.mark.parametrize("preset", ["craters", "mesa", "canyon", "mounds"])
def test_walls_that_a_stage_cuts_fade_on_the_plain(preset: str) -> None:
    """They went on outward as trenches and ridges, as steep as at the edge."""
    ground = make_ground(preset, 64.0, 385, np.random.default_rng(7))
    plain = plain_around(ground)
    rings_m = plain.vertices_m.reshape(-1, 4 * EDGE_POINTS, 3).astype(np.float64)
    reach = np.abs(rings_m[:, :, 0]).max(axis=1) / 32
    steps_m = np.diff(rings_m, axis=1, append=rings_m[:, :1])
    steep = np.abs(steps_m[..., 2]) / np.linalg.norm(steps_m[..., :2], axis=-1)
    slope_deg = np.degrees(np.arctan(steep.max(axis=1)))

    assert slope_deg[1] > 25, "the edge cuts walls"
    # In the relief over the stage's edge: walls of a canyon are twice as high as those of a mesa.
    assert steep[reach > 1.35].max() < 1.6 * np.ptp(ground.elevation_m) / 64
    assert slope_deg[reach > 1.8].max() < 3
    at_edge = rings_m[1]
    assert plain.level_m is not None
    np.testing.assert_allclose(ground.height_at(at_edge[:, :2] * 0.9999), at_edge[:, 2], atol=0.15)
    assert (rings_m[1:, :, 2] >= plain.level_m - 1e-5).all(), (
        "rays meet the plane where it is higher"
    )


def test_water_cuts_valleys_into_the_land_that_join_and_wind_does_not() -> None:
    """Of a land's far points, those beside a valley's are higher; noise has as many of both."""
    ground = stage()
    lands = {by: land_around(ground, 5, EARTH_RADIUS_M, shaped_by=by) for by in ("water", "wind")}
    skew = {}
    for by, land in lands.items():
        at = np.linspace(-100.0, 100.0, 101)
        xy_m = np.stack(np.meshgrid(at + 220.0, at), axis=-1).reshape(-1, 2)
        height_m = land.height_at(xy_m).reshape(101, 101)
        bent = np.diff(height_m, n=2, axis=0)[:, 1:-1] + np.diff(height_m, n=2, axis=1)[1:-1]
        skew[by] = float((bent**3).mean() / (bent**2).mean() ** 1.5)
    assert skew["water"] < skew["wind"] - 0.2, "crests are sharper than beds"


@pytest.mark.parametrize("shape", [(2, 4000), (4000, 2), (3, 9)])
def test_the_relief_of_a_strip_is_that_along_it(shape: tuple[int, int]) -> None:
    """One narrower than the spacing of thinned points ended commands with a traceback."""
    along = np.arange(max(shape)) * 0.5
    height_m = np.broadcast_to(np.sin(along * np.pi / 3), (min(shape), max(shape)))
    height_m = np.ascontiguousarray(height_m if shape[0] < shape[1] else height_m.T, np.float32)
    octaves = own_octaves(HeightField(height_m, (0.0, 0.0), 0.5))
    assert len(octaves) == 1
    assert 0 < octaves[0].deviation_m < 1


def test_land_surrounds_a_mesh_that_is_a_strip() -> None:
    x = np.repeat(np.linspace(-1000, 1000, 201), 2)
    y = np.tile((-1.0, 1.0), 201)
    points = np.column_stack((x, y, np.sin(x / 10))).astype(np.float32)
    pair = np.array([(0, 2, 1), (2, 3, 1)])
    corners = (2 * np.arange(200)[:, None, None] + pair).reshape(-1, 3).astype(np.int32)
    land = land_around(MeshGround(points, corners), 5, EARTH_RADIUS_M)
    assert np.isfinite(land.vertices_m).all()
