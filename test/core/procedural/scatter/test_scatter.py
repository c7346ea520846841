"""Rocks and where they lie."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from oaisys_core.config.sections.assets import RockGroupConfig
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.scatter.abundance import rock_abundance
from oaisys_core.procedural.scatter.groups import scatter_group
from oaisys_core.procedural.scatter.placement.density import bilinear
from oaisys_core.procedural.scatter.placement.random_poses import power_law_sizes, scatter_on
from oaisys_core.procedural.scatter.rock_families import ROUNDED, family_density
from oaisys_core.procedural.scatter.rocks import (
    ROCK_KINDS,
    directions_on_edges,
    fine_rock,
    icosphere,
    make_rock,
)
from oaisys_core.procedural.terrain.presets import make_ground
from oaisys_core.procedural.terrain.water.moisture import moisture
from oaisys_core.scene import HeightField, MeshPrototype
from oaisys_core.types import FloatArray


def sizes_m_of(count: int, least_m: float, most_m: float) -> FloatArray:
    return power_law_sizes(count, (least_m, most_m), 1.8, np.random.default_rng(count))


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


def test_facets_of_broken_rocks_are_plane_up_to_their_edges() -> None:
    directions, triangles = icosphere(3)
    turned = Rotation.from_rotvec((0.4, -0.7, 0.3)).as_matrix()
    planes = np.concatenate((turned, -turned)) / 0.5

    def volume_m3(directions: FloatArray) -> float:
        vertices = directions / (directions @ planes.T).max(axis=1, keepdims=True)
        a, b, c = (vertices[triangles[:, i]] for i in range(3))
        return float((a * np.cross(b, c)).sum() / 6)

    moved = directions_on_edges(directions, triangles, lambda at: np.asarray(at @ planes.T))
    assert np.allclose(np.linalg.norm(moved, axis=1), 1)
    # Chords cut corners off a cube of 1 m³.
    missing, still_missing = 1 - volume_m3(directions), 1 - volume_m3(moved)
    assert missing > 0.015
    assert 0 <= still_missing < 0.25 * missing


def test_broken_rocks_have_sharp_edges_and_worn_ones_have_none() -> None:
    for kind in ROCK_KINDS:
        rocks = [fine_rock(kind, np.random.default_rng(s), 3) for s in range(4)]
        sharp = np.mean([_share_of_sharp_bends(rock) for rock in rocks])
        assert sharp < 0.15 if kind in ROUNDED else sharp > 0.45, kind


def _share_of_sharp_bends(rock: MeshPrototype) -> float:
    """Return the share of all bending, angle times length, that is in edges above 24 degrees."""
    vertices_m, triangles = rock.vertices_m.astype(float), rock.triangles
    a, b, c = (vertices_m[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sides = np.sort(np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    order = np.lexsort(sides.T)
    of_side = np.tile(np.arange(len(triangles)), 3)[order].reshape(-1, 2)
    start, end = vertices_m[sides[order][::2]].transpose(1, 0, 2)
    angle_rad = np.arccos(np.clip((normals[of_side[:, 0]] * normals[of_side[:, 1]]).sum(1), -1, 1))
    bend = angle_rad * np.linalg.norm(end - start, axis=1)
    return float(bend[angle_rad > np.radians(24)].sum() / bend.sum())


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
    rocks = [make_rock(kind, rng, 3) for _ in range(3)]
    T_map_object, _, shape_of = scatter_on(ground, sizes_m_of(300, 0.2, 1.5), rng, shapes=rocks)
    for T, index in zip(T_map_object, shape_of, strict=True):
        vertices_m = rocks[index].vertices_m @ T[:3, :3].T + T[:3, 3]
        above_m = vertices_m[:, 2] - ground.height_at(vertices_m[:, :2])
        assert np.nanmin(above_m) < 0, "its lowest part is in the ground"
        assert np.nanmax(above_m) > 0, "and its highest is not"


@pytest.mark.parametrize("kind", sorted(ROCK_KINDS))
@pytest.mark.parametrize("place", ["rocks", "group"])
def test_most_rocks_lie_on_level_ground_and_a_few_are_embedded(kind: str, place: str) -> None:
    """The median rock was sunk by half of its height, and lay in the ground like a tile."""
    x = np.zeros((129, 129), np.float32)
    ground, rng = HeightField(x, (-100.0, -100.0), 200 / 128), np.random.default_rng(13)
    rocks = [make_rock(kind, rng, 3) for _ in range(6)]
    if place == "rocks":
        config = RockGroupConfig(kind=kind)
        T, _, shape_of = scatter_on(
            ground, sizes_m_of(600, 0.2, 1.5), rng, sink=config.sink, shapes=rocks
        )
    else:
        group = GroupConfig(
            name="g", label="g", semantic_id=9, shape=kind, count=(600, 600), size_m=(0.2, 1.5)
        )
        T, shape_of = scatter_group(group, 600, rocks, ground, rng)
    heights_m = [
        rocks[index].vertices_m @ pose[2, :3] + pose[2, 3]
        for pose, index in zip(T, shape_of, strict=True)
    ]
    buried = np.array([-z.min() / np.ptp(z) for z in heights_m])
    assert buried.min() >= 0.1
    assert buried.max() <= 0.61
    assert ((buried > 0.1) & (buried < 0.25)).mean() > 0.55
    assert 0.08 < (buried > 0.4).mean() < 0.25


def test_rocks_lie_below_a_scarp_rather_than_above() -> None:
    """Rocks that roll come to rest where their source is seen at 27.5 degrees or steeper."""
    x = np.linspace(-50, 50, 129)
    step_m = np.tile(10 / (1 + np.exp(-x)), (129, 1)).astype(np.float32)
    ground = HeightField(step_m, (-50.0, -50.0), 100 / 128)
    liked = family_density("angular", ground)
    away_m = np.array([5.0, 8.0, 11.0, 40.0])
    below = liked(np.column_stack((-away_m, np.zeros(4))))
    above = liked(np.column_stack((away_m, np.zeros(4))))
    assert (below[:2] > 1.5 * above[:2]).all()
    assert (np.diff(below) <= 0).all()
    assert 10 / np.tan(np.radians(27.5)) < 40
    assert below[3] == pytest.approx(above[3], abs=0.01)


def test_rocks_keep_their_distance(ground: HeightField) -> None:
    T_map_object, sizes_m, _ = scatter_on(
        ground, sizes_m_of(400, 0.3, 1.0), np.random.default_rng(2), min_spacing=1.0
    )
    pairs = cKDTree(T_map_object[:, :2, 3]).query_pairs(1.0, output_type="ndarray")
    gap_m = np.linalg.norm(
        T_map_object[pairs[:, 0], :2, 3] - T_map_object[pairs[:, 1], :2, 3], axis=1
    )
    assert (gap_m >= sizes_m[pairs].mean(axis=1) - 1e-9).all()
    assert len(sizes_m) == 400


def test_poses_are_rotations_times_the_size(ground: HeightField) -> None:
    T_map_object, sizes_m, _ = scatter_on(
        ground, sizes_m_of(50, 0.3, 1.0), np.random.default_rng(3)
    )
    R = T_map_object[:, :3, :3] / sizes_m[:, None, None]
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(R), 1)


def test_things_lie_flat_on_a_slope() -> None:
    x = np.linspace(-20, 20, 129)
    slope = np.tile(np.tan(np.radians(30)) * x, (129, 1)).astype(np.float32)
    ground = HeightField(slope, (-20.0, -20.0), 40 / 128)
    T_map_object, sizes_m, _ = scatter_on(
        ground,
        sizes_m_of(60, 0.3, 2.0),
        np.random.default_rng(8),
        sink=(0.0, 0.0),
        max_tilt_deg=0.0,
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
        T, sizes_m, _ = scatter_on(ground, sizes_m_of(2000, 0.2, 2.0), rng, min_spacing=0.0)
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
        T, _, _ = scatter_on(ground, sizes_m_of(400, 0.1, 0.2), rng, clumping=0.0, preference=liked)
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
    T_map_object, _, _ = scatter_on(
        ground, sizes_m_of(100, 0.2, 0.5), np.random.default_rng(4), max_slope_deg=40.0
    )
    assert len(T_map_object) == 100
    assert (T_map_object[:, 0, 3] <= 0.4).all()


def test_where_there_is_no_room_fewer_are_placed() -> None:
    ground = make_ground("plane", 4.0, 9, np.random.default_rng(0))
    T_map_object, sizes_m, _ = scatter_on(
        ground, sizes_m_of(500, 1.0, 1.0), np.random.default_rng(5), min_spacing=1.0
    )
    assert 0 < len(T_map_object) == len(sizes_m) < 40


def test_nothing_is_placed_where_nothing_is_wanted(ground: HeightField) -> None:
    T_map_object, _, _ = scatter_on(ground, sizes_m_of(0, 0.2, 0.5), np.random.default_rng(6))
    assert T_map_object.shape == (0, 4, 4)


def test_fragments_lie_in_clusters_beside_larger_rocks(ground: HeightField) -> None:
    def spread(fragments: float) -> float:
        """Return the mean distance to the next rock over that of rocks anywhere (Clark and Evans,
        Ecology 35(4), 1954).
        """
        rng = np.random.default_rng(11)
        sizes_m = sizes_m_of(600, 0.1, 1.0)
        T, _, _ = scatter_on(ground, sizes_m, rng, clumping=0.0, fragments=fragments)
        assert len(T) == 600
        xy = T[:, :2, 3]
        nearest_m = cKDTree(xy).query(xy, k=2)[0][:, 1].mean()
        x0, y0, x1, y1 = ground.extent_m
        return float(nearest_m / (0.5 * np.sqrt((x1 - x0) * (y1 - y0) / 600)))

    # By their standard error, 0.261 / 0.5 / sqrt(600).
    error = 0.0213
    assert abs(spread(0.0) - 1.0) < 5 * error
    assert spread(0.5) < 1.0 - 5 * error


def test_rocks_cover_as_much_ground_as_golombek_and_rapp_say() -> None:
    cover, least_m, most_m = 0.08, 0.1, 1.5
    q = 1.79 + 0.152 / cover
    rocks = rock_abundance(cover, (least_m, most_m))
    sizes_m = rocks.draw(200_000, np.random.default_rng(12))
    assert sizes_m.min() >= least_m
    assert sizes_m.max() <= most_m
    for above_m in (least_m, 0.3):
        area_m2 = np.pi / 4 * (sizes_m[sizes_m >= above_m] ** 2).sum() / len(sizes_m)
        expected = cover * (np.exp(-q * above_m) - np.exp(-q * most_m))
        assert rocks.per_m2 * area_m2 == pytest.approx(expected, rel=0.03)


def test_sizes_follow_the_power_law() -> None:
    sizes_m = power_law_sizes(200_000, (0.1, 100.0), 1.8, np.random.default_rng(7))
    assert sizes_m.min() >= 0.1
    assert sizes_m.max() <= 100.0
    steps_m = np.array([0.15, 0.3, 0.6, 1.2])
    above = np.array([(sizes_m > step_m).sum() for step_m in steps_m])
    exponent = -np.polyfit(np.log(steps_m), np.log(above), 1)[0]
    assert exponent == pytest.approx(1.8, abs=0.05)


def test_things_are_sunk_deeper_on_a_slope() -> None:
    x = np.linspace(-20, 20, 129)
    shares = []
    for slope in (0.0, 0.7):
        plane_m = np.tile(slope * x, (129, 1)).astype(np.float32)
        ground = HeightField(plane_m, (-20.0, -20.0), 40 / 128)
        T_map_object, sizes_m, _ = scatter_on(
            ground, sizes_m_of(60, 0.3, 2.0), np.random.default_rng(8), max_tilt_deg=0.0
        )
        depth_m = slope * T_map_object[:, 0, 3] - T_map_object[:, 2, 3]
        shares.append(np.mean(depth_m / sizes_m))
    assert shares[1] == pytest.approx(1.9 * shares[0], rel=0.1)
