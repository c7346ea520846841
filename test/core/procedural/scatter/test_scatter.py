"""Rocks and where they lie."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.scatter.density import bilinear
from oaisys_core.procedural.scatter.placement import power_law_sizes, scatter_on
from oaisys_core.procedural.scatter.rock_families import family_density
from oaisys_core.procedural.scatter.rocks import ROCK_KINDS, icosphere, make_rock
from oaisys_core.procedural.terrain.moisture import moisture
from oaisys_core.procedural.terrain.presets import make_ground
from oaisys_core.scene import HeightField


@pytest.fixture(scope="module")
def ground() -> HeightField:
    return make_ground("mounds", 40.0, 257, np.random.default_rng(0))


@pytest.mark.parametrize("kind", sorted(ROCK_KINDS))
def test_rocks_are_closed_and_face_outwards(kind: str) -> None:
    rock = make_rock(kind, np.random.default_rng(5), 3)
    edges = np.concatenate([rock.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    unique, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    assert (count == 2).all(), "every edge belongs to two triangles"
    assert len(rock.vertices_m) - len(unique) + len(rock.triangles) == 2, "Euler: no handles"
    a, b, c = (rock.vertices_m[rock.triangles[:, i]].astype(float) for i in range(3))
    volume_m3 = (a * np.cross(b, c)).sum() / 6
    assert 0.02 < volume_m3 < 0.6
    size_m = np.ptp(rock.vertices_m, axis=0)
    assert size_m.max() == pytest.approx(1.0, abs=1e-5)
    assert rock.vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-6)


def test_kinds_differ_as_their_names_say() -> None:
    def height(kind: str) -> float:
        rocks = [make_rock(kind, np.random.default_rng(s), 3) for s in range(5)]
        return float(np.mean([rock.vertices_m[:, 2].max() for rock in rocks]))

    assert height("slab") < 0.7 * height("boulder")


def test_rocks_repeat_by_seed() -> None:
    one, two, other = (make_rock("angular", np.random.default_rng(s), 2) for s in (1, 1, 2))
    assert one.vertices_m.tobytes() == two.vertices_m.tobytes()
    assert one.vertices_m.tobytes() != other.vertices_m.tobytes()


def test_unknown_kinds_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="slab"):
        make_rock("cube", np.random.default_rng(0), 1)


@pytest.mark.parametrize("subdivisions", [0, 1, 3])
def test_an_icosphere_has_20_times_4_to_the_n_triangles(subdivisions: int) -> None:
    points, triangles = icosphere(subdivisions)
    assert len(triangles) == 20 * 4**subdivisions
    assert np.allclose(np.linalg.norm(points, axis=1), 1)


@pytest.mark.parametrize("kind", sorted(ROCK_KINDS))
def test_no_rock_floats(ground: HeightField, kind: str) -> None:
    rng = np.random.default_rng(1)
    rock = make_rock(kind, rng, 3).vertices_m
    height = float(rock[:, 2].max())
    T_map_object, _ = scatter_on(ground, 300, (0.2, 1.5), rng, height_share=height)
    for T in T_map_object:
        vertices_m = rock @ T[:3, :3].T + T[:3, 3]
        above_m = vertices_m[:, 2] - ground.height_at(vertices_m[:, :2])
        assert np.nanmin(above_m) < 0, "its lowest part is in the ground"
        assert np.nanmax(above_m) > 0, "and its highest is not"


def test_rocks_keep_their_distance(ground: HeightField) -> None:
    T_map_object, sizes_m = scatter_on(
        ground, 400, (0.3, 1.0), np.random.default_rng(2), min_spacing=1.0
    )
    pairs = cKDTree(T_map_object[:, :2, 3]).query_pairs(1.0, output_type="ndarray")
    gap_m = np.linalg.norm(
        T_map_object[pairs[:, 0], :2, 3] - T_map_object[pairs[:, 1], :2, 3], axis=1
    )
    assert (gap_m >= sizes_m[pairs].mean(axis=1) - 1e-9).all()
    assert len(sizes_m) == 400


def test_poses_are_rotations_times_the_size(ground: HeightField) -> None:
    T_map_object, sizes_m = scatter_on(ground, 50, (0.3, 1.0), np.random.default_rng(3))
    R = T_map_object[:, :3, :3] / sizes_m[:, None, None]
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(R), 1)


def test_things_lie_flat_on_a_slope() -> None:
    x = np.linspace(-20, 20, 129)
    slope = np.tile(np.tan(np.radians(30)) * x, (129, 1)).astype(np.float32)
    ground = HeightField(slope, (-20.0, -20.0), 40 / 128)
    T_map_object, sizes_m = scatter_on(
        ground, 60, (0.3, 2.0), np.random.default_rng(8), sink=(0.0, 0.0), max_tilt_deg=0.0
    )
    up = T_map_object[:, :3, 2] / sizes_m[:, None]
    assert np.allclose(up, (-0.5, 0.0, np.sqrt(0.75)), atol=1e-5)
    assert np.allclose(
        T_map_object[:, 2, 3], np.tan(np.radians(30)) * T_map_object[:, 0, 3], atol=1e-4
    )


def test_large_things_lie_flatter_and_slid_ones_point_downhill() -> None:
    x = np.linspace(-20, 20, 129)
    for steepness in (0.0, 0.6):
        field = np.tile(steepness * x, (129, 1)).astype(np.float32)
        ground = HeightField(field, (-20.0, -20.0), 40 / 128)
        rng = np.random.default_rng(8)
        T, sizes_m = scatter_on(ground, 300, (0.2, 2.0), rng, min_spacing=0.0)
        R = T[:, :3, :3] / sizes_m[:, None, None]
        normal = np.array((-steepness, 0.0, 1.0)) / np.hypot(steepness, 1.0)
        lean_rad = np.arccos(R[:, :, 2] @ normal)
        large = sizes_m > 0.6
        assert lean_rad[large].mean() < 0.7 * lean_rad[~large].mean()
        downhill = np.abs(R[:, 0, 0]) > 0.6
        assert downhill.mean() > 0.75 if steepness else downhill.mean() < 0.65


def test_rounded_rocks_lie_where_water_runs_and_angular_ones_near_scarps() -> None:
    x = np.linspace(-20, 20, 129)
    step = 6 / (1 + np.exp(-(x + 8) / 0.8)) + 0.05 * np.abs(x)
    field = np.tile(step, (129, 1)) + 0.02 * np.abs(x)[:, None]
    ground = HeightField(field.astype(np.float32), (-20.0, -20.0), 40 / 128)
    at: dict[str, np.ndarray] = {}
    for kind in ("angular", "rounded"):
        liked = family_density(kind, ground)
        rng = np.random.default_rng(9)
        T, _ = scatter_on(ground, 400, (0.1, 0.2), rng, clumping=0.0, preference=liked)
        assert len(T) == 400
        at[kind] = T[:, :2, 3]
    near = {kind: (np.abs(xy[:, 0] + 8) < 5).mean() for kind, xy in at.items()}
    assert near["angular"] > 1.3 * near["rounded"]
    wet = {kind: bilinear(moisture(ground), ground, xy).mean() for kind, xy in at.items()}
    assert wet["rounded"] > wet["angular"] + 0.1


def test_no_rock_stands_on_steep_ground() -> None:
    x = np.linspace(-20, 20, 129)
    slope = np.where(x > 0, np.tan(np.radians(50)) * x, 0).astype(np.float32)
    ground = HeightField(np.tile(slope, (129, 1)), (-20.0, -20.0), 40 / 128)
    T_map_object, _ = scatter_on(
        ground, 100, (0.2, 0.5), np.random.default_rng(4), max_slope_deg=40.0
    )
    assert len(T_map_object) == 100
    assert (T_map_object[:, 0, 3] <= 0.4).all()


def test_where_there_is_no_room_fewer_are_placed() -> None:
    ground = make_ground("plane", 4.0, 9, np.random.default_rng(0))
    T_map_object, sizes_m = scatter_on(
        ground, 500, (1.0, 1.0), np.random.default_rng(5), min_spacing=1.0
    )
    assert 0 < len(T_map_object) == len(sizes_m) < 40


def test_nothing_is_placed_where_nothing_is_wanted(ground: HeightField) -> None:
    T_map_object, _ = scatter_on(ground, 0, (0.2, 0.5), np.random.default_rng(6))
    assert T_map_object.shape == (0, 4, 4)


def test_sizes_follow_the_power_law() -> None:
    sizes_m = power_law_sizes(200_000, (0.1, 100.0), 1.8, np.random.default_rng(7))
    assert sizes_m.min() >= 0.1
    assert sizes_m.max() <= 100.0
    steps_m = np.array([0.15, 0.3, 0.6, 1.2])
    above = np.array([(sizes_m > step_m).sum() for step_m in steps_m])
    exponent = -np.polyfit(np.log(steps_m), np.log(above), 1)[0]
    assert exponent == pytest.approx(1.8, abs=0.05)
