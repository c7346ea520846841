"""What a volume does beyond plain fusion: weights, clearing, classes, little memory, files."""

import hashlib
import time
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
import trimesh
from scipy.spatial import cKDTree
from test_tsdf import CAMERA, camera_at, plane_depth_m, sphere_depth_m

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import read_class_names, read_ply, write_ply
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume, VolumeFullError
from oaisys_mapping.voxels.fields import CLASSES_KEPT
from oaisys_mapping.voxels.marching_cubes import triangle_table
from oaisys_mapping.voxels.semantic_fusion import (
    class_color,
    fuse_classes,
    most_likely,
)

UP = np.array([0.0, 0.0, 1.0])
ABOVE = camera_at((0.01, 0, 6), (0, 0, 0))
GROUND_M = plane_depth_m(ABOVE, UP, 0.0)
SKY_M = np.full((240, 320), np.inf, np.float32)


def flight(count: int, spacing_m: float = 4.0) -> list[FloatArray]:
    return [camera_at((spacing_m * i + 0.01, 0, 6), (spacing_m * i, 0, 0)) for i in range(count)]


def fly(volume: TsdfVolume, poses: list[FloatArray]) -> TsdfVolume:
    normal = np.array([0.1, 0.05, 1.0])
    normal /= np.linalg.norm(normal)
    for index, T in enumerate(poses):
        rgb = np.full((240, 320, 3), (40 * index % 256, 100, 50), np.uint8)
        labels = np.full((240, 320), 1 + index % 3, np.uint16)
        depth_m = plane_depth_m(T, normal, 0.033)
        volume.integrate(depth_m, rgb, CAMERA, T, labels)
    return volume


def same(one: ColoredMesh, other: ColoredMesh) -> bool:
    names = ("vertices_m", "triangles", "colors_rgb", "class_ids", "class_probabilities")
    pairs = [(getattr(one, name), getattr(other, name)) for name in names]
    return all(a is b is None or np.array_equal(a, b) for a, b in pairs)


def as_triangle_set(mesh: ColoredMesh) -> set[bytes]:
    corners = np.round(mesh.vertices_m[mesh.triangles], 6)
    return {np.sort(each, axis=0).tobytes() for each in corners}


# Agreement with other implementations


@pytest.mark.parametrize(("views", "usual_m", "mean_m"), [(1, 1e-4, 2e-3), (6, 2e-3, 1e-2)])
def test_geometry_is_that_of_open3d_on_the_same_views(
    views: int, usual_m: float, mean_m: float
) -> None:
    """To a hair of one view; of several, theirs means all alike, ours by what each could see."""
    config = TsdfConfig(clear_free_space=False, solid_voxels=0)
    volume = TsdfVolume(config)
    kind = o3d.core.float32
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (kind, kind, kind), ((1), (1), (3)), 0.1, 8, 5000
    )
    K = CAMERA.K
    K[:2, 2] += 0.5  # Open3D cuts the fraction of a pixel off
    for azimuth_rad in np.linspace(0, 2 * np.pi, views, endpoint=False):
        eye_m = (5 * np.cos(azimuth_rad), 5 * np.sin(azimuth_rad), 2.0)
        T = camera_at(eye_m, (0, 0, 0))
        depth_m = sphere_depth_m(T, 1.5)
        volume.integrate(depth_m, None, CAMERA, T)
        shown = o3d.t.geometry.Image(np.where(np.isfinite(depth_m), depth_m, 0).astype("f4"))
        color = o3d.t.geometry.Image(np.zeros((240, 320, 3), np.float32))
        E = o3d.core.Tensor(invert(T))
        intrinsic = o3d.core.Tensor(K)
        plain = o3d.core.Tensor(CAMERA.K)
        far = (1.0, 60.0, 3.0)
        blocks = grid.compute_unique_block_coordinates(shown, plain, E, *far)
        grid.integrate(blocks, shown, color, intrinsic, intrinsic, E, *far)
    theirs = grid.extract_triangle_mesh(0.5).vertex.positions.numpy()
    ours = volume.extract_mesh().vertices_m
    assert len(ours) == pytest.approx(len(theirs), rel=0.01)
    for a, b in ((ours, theirs), (theirs, ours)):
        away_m, _ = cKDTree(a).query(b)
        assert np.median(away_m) < usual_m
        assert away_m.mean() < mean_m


def test_meshes_are_closed_and_face_outwards() -> None:
    volume = TsdfVolume(TsdfConfig(truncation_voxels=8.0))
    for axis in range(3):
        for sign in (-1.0, 1.0):
            eye_m = np.array([0.013, 0.017, 0.011])
            eye_m[axis] = 5 * sign
            T = camera_at(tuple(eye_m), (0, 0, 0))
            volume.integrate(sphere_depth_m(T, 1.5), None, CAMERA, T)
    mesh = volume.extract_mesh()
    theirs = trimesh.Trimesh(mesh.vertices_m, mesh.triangles, process=False)
    assert theirs.is_watertight
    assert theirs.is_winding_consistent
    # Positive where triangles face outwards, and the sphere's own.
    assert theirs.volume == pytest.approx(4 / 3 * np.pi * 1.5**3, rel=0.03)
    away_m = np.linalg.norm(mesh.vertices_m, axis=1) - 1.5
    assert np.sqrt(np.square(away_m).mean()) < 0.02


def test_the_table_has_every_crossed_edge_and_no_other() -> None:
    triangles, first, end = triangle_table()
    assert (first[0], first[255]) == (end[0], end[255])
    for cube in range(256):
        used = set(triangles[first[cube] : end[cube]].ravel().tolist())
        corners = [(c, a) for c in range(8) for a in range(3) if not c >> a & 1]
        crossed = {
            number
            for number, (corner, axis) in enumerate(corners)
            if (cube >> corner & 1) != (cube >> (corner | 1 << axis) & 1)
        }
        assert used == crossed


# Clearing and weights


@pytest.mark.parametrize("beyond", ["ground", "sky"])
def test_a_thing_that_moved_away_disappears(beyond: str) -> None:
    volume = TsdfVolume(TsdfConfig(max_range_m=20.0))
    with_ball_m = np.minimum(GROUND_M, sphere_depth_m(ABOVE @ _shifted(0, 0, -2), 0.7))
    away_m = GROUND_M if beyond == "ground" else SKY_M
    for depth_m in (with_ball_m, with_ball_m, away_m, away_m, away_m):
        volume.integrate(depth_m, None, CAMERA, ABOVE)
    heights_m = volume.extract_mesh().vertices_m[:, 2]
    assert (heights_m < 0.5).all()
    if beyond == "ground":
        assert len(heights_m) > 1000


def test_it_stays_where_rays_do_not_clear() -> None:
    volume = TsdfVolume(TsdfConfig(clear_free_space=False))
    with_ball_m = np.minimum(GROUND_M, sphere_depth_m(ABOVE @ _shifted(0, 0, -2), 0.7))
    for depth_m in (with_ball_m, GROUND_M, GROUND_M, GROUND_M):
        volume.integrate(depth_m, None, CAMERA, ABOVE)
    assert (volume.extract_mesh().vertices_m[:, 2] > 1.5).any()


def test_sky_clears_up_to_the_range_and_no_further() -> None:
    volume = TsdfVolume(TsdfConfig(max_range_m=5.05))
    near_m = np.full((240, 320), 4.0, np.float32)
    volume.integrate(near_m, None, CAMERA, ABOVE)
    for _ in range(3):
        volume.integrate(SKY_M, None, CAMERA, ABOVE)
    assert len(volume.extract_mesh().triangles) == 0
    assert volume.distance_at(np.array([(0.05, 0.0, 2.0)]))[0] > 0
    # 5.05 m below the camera is z = 0.95; what lies behind it is not told about.
    assert np.isnan(volume.distance_at(np.array([(0.05, 0.0, 0.75)]))[0])


def test_pixels_that_tell_nothing_clear_nothing() -> None:
    volume = TsdfVolume()
    volume.integrate(GROUND_M, None, CAMERA, ABOVE)
    before = volume.extract_mesh()
    for nothing in (np.nan, -np.inf, 0.0, -1.0):
        volume.integrate(np.full((240, 320), nothing, np.float32), None, CAMERA, ABOVE)
    assert same(before, volume.extract_mesh())


def test_near_pixels_count_more_by_the_inverse_square() -> None:
    """A plane seen 0.1 m too high from 3 m, and 0.1 m too low from 6 m."""
    found_m = {}
    for weighting in ("constant", "inverse_square"):
        volume = TsdfVolume(TsdfConfig(weighting=weighting, truncation_voxels=5.0))
        for height_m, offset_m in ((3.0, 0.1), (6.0, -0.1)):
            T = camera_at((0.01, 0, height_m), (0, 0, 0))
            volume.integrate(plane_depth_m(T, UP, offset_m), None, CAMERA, T)
        heights_m = volume.extract_mesh().vertices_m
        middle = np.abs(heights_m[:, :2]).max(axis=1) < 1
        found_m[weighting] = heights_m[middle, 2].mean()
    near, far = 1 / 2.9**2, 1 / 6.1**2
    assert found_m["constant"] == pytest.approx(0.0, abs=0.01)
    expected_m = 0.1 * (near - far) / (near + far)
    assert found_m["inverse_square"] == pytest.approx(expected_m, abs=0.01)


def test_slanting_rays_count_less_by_incidence() -> None:
    """A plane seen 0.1 m too high from straight above, and 0.1 m too low at 60 degrees."""
    volume = TsdfVolume(TsdfConfig(weigh_incidence=True, truncation_voxels=6.0))
    slanting = camera_at((5.2, 0, 3), (0, 0, 0))
    for T, offset_m in ((ABOVE, 0.1), (slanting, -0.1)):
        volume.integrate(plane_depth_m(T, UP, offset_m), None, CAMERA, T)
    vertices_m = volume.extract_mesh().vertices_m
    middle = np.abs(vertices_m[:, :2]).max(axis=1) < 0.3
    # Along the slanting ray a height of h is h / cos(60 deg) = 2 h, at half the weight.
    assert vertices_m[middle, 2].mean() == pytest.approx(0.0, abs=0.02)


def test_a_voxel_that_is_sure_can_still_change_its_mind() -> None:
    higher_m = plane_depth_m(ABOVE, UP, 0.1)
    heights_m = {}
    for max_weight in (4.0, 1000.0):
        volume = TsdfVolume(TsdfConfig(max_weight=max_weight))
        for depth_m in [GROUND_M] * 20 + [higher_m] * 10:
            volume.integrate(depth_m, None, CAMERA, ABOVE)
        heights_m[max_weight] = volume.extract_mesh().vertices_m[:, 2].mean()
    assert heights_m[4.0] > 0.08
    assert heights_m[1000.0] == pytest.approx(0.1 / 3, abs=0.01)


# Meshes that are kept


def test_a_mesh_that_was_kept_is_that_which_is_made_anew() -> None:
    kept, anew = TsdfVolume(TsdfConfig(semantic=True)), TsdfVolume(TsdfConfig(semantic=True))
    for T in flight(5):
        fly(kept, [T])
        kept.extract_mesh()
    for T in flight(5):
        fly(anew, [T])
    assert len(anew.extract_mesh().triangles) > 10_000
    assert same(kept.extract_mesh(), anew.extract_mesh())
    kept.forget_mesh()
    assert same(kept.extract_mesh(), anew.extract_mesh())


def test_vertices_are_shared_across_blocks() -> None:
    mesh = fly(TsdfVolume(), flight(3)).extract_mesh()
    assert len(np.unique(mesh.vertices_m, axis=0)) == len(mesh.vertices_m)
    assert len(np.unique(mesh.triangles)) == len(mesh.vertices_m)
    # A surface without holes has about twice as many triangles as vertices.
    assert 1.9 < len(mesh.triangles) / len(mesh.vertices_m) < 2.0


# Memory


@pytest.mark.parametrize("when_full", ["drop", "store"])
def test_memory_is_bounded_wherever_the_camera_goes(when_full: str, tmp_path: Path) -> None:
    limited = TsdfVolume(TsdfConfig(max_blocks=600, when_full=when_full, store_folder=tmp_path))
    free = TsdfVolume()
    for T in flight(12):
        for volume in (limited, free):
            fly(volume, [T])
        assert limited.blocks_in_memory <= 600
    assert free.blocks_in_memory > 1500
    assert list(tmp_path.iterdir()) == []
    reach_m = {
        name: volume.extract_mesh().vertices_m[:, 0]
        for name, volume in (("limited", limited), ("free", free))
    }
    assert reach_m["limited"].max() == pytest.approx(reach_m["free"].max())
    if when_full == "drop":
        assert limited.blocks_stored == 0
        assert reach_m["limited"].min() > 10
    else:
        assert limited.blocks_stored > 900
        assert same(limited.extract_mesh(), free.extract_mesh())
        near = limited.extract_mesh(with_stored=False)
        assert 0 < len(near.triangles) < 0.7 * len(free.extract_mesh().triangles)


def test_stored_blocks_come_back_with_the_camera(tmp_path: Path) -> None:
    there_and_back = [*flight(10), *flight(10)[::-1]]
    limited = TsdfVolume(TsdfConfig(max_blocks=600, when_full="store", semantic=True))
    free = TsdfVolume(TsdfConfig(semantic=True))
    fly(limited, there_and_back)
    fly(free, there_and_back)
    assert same(limited.extract_mesh(), free.extract_mesh())
    assert limited.blocks_in_memory + limited.blocks_stored == free.blocks_in_memory
    limited.save(tmp_path / "limited.npz")
    free.save(tmp_path / "free.npz")
    assert (tmp_path / "limited.npz").read_bytes() == (tmp_path / "free.npz").read_bytes()


@pytest.mark.parametrize("when_full", ["refuse", "drop", "store"])
def test_a_view_that_alone_is_too_large_is_refused(when_full: str) -> None:
    volume = TsdfVolume(TsdfConfig(max_blocks=20, when_full=when_full))
    with pytest.raises(VolumeFullError, match="20 may be used"):
        volume.integrate(GROUND_M, None, CAMERA, ABOVE)
    assert volume.is_empty


# Files


def test_equal_views_give_equal_files_whenever_they_are_written(tmp_path: Path) -> None:
    digests = []
    for name in ("one.npz", "two.npz"):
        volume = fly(TsdfVolume(TsdfConfig(semantic=True)), flight(3))
        volume.save(tmp_path / name)
        digests.append(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
        time.sleep(2.1)  # a zip file's times have two seconds' resolution
    assert digests[0] == digests[1]


def test_a_loaded_volume_goes_on_as_the_saved_one_would(tmp_path: Path) -> None:
    config = TsdfConfig(semantic=True, record_free_space=True, max_range_m=12.0)
    poses = flight(4)
    saved = fly(TsdfVolume(config), poses[:3])
    saved.save(tmp_path / "volume.npz")
    loaded = TsdfVolume(config)
    loaded.load(tmp_path / "volume.npz")
    assert loaded.frames == 3
    for volume in (saved, loaded):
        fly(volume, poses[3:])
    assert same(saved.extract_mesh(), loaded.extract_mesh())
    assert saved.observed_volume_m3 == loaded.observed_volume_m3
    with np.load(tmp_path / "volume.npz") as arrays:
        assert arrays["tsdf"].shape == (len(arrays["blocks"]), 8, 8, 8)
        assert np.abs(arrays["tsdf"]).max() <= 1
        assert arrays["weight"].max() == 2


def test_a_file_without_classes_is_refused_by_a_volume_with_classes(tmp_path: Path) -> None:
    fly(TsdfVolume(), flight(1)).save(tmp_path / "volume.npz")
    with pytest.raises(InvalidInputError, match="class_id"):
        TsdfVolume(TsdfConfig(semantic=True)).load(tmp_path / "volume.npz")


# Classes


def halves(left: int, right: int) -> np.ndarray:
    labels = np.full((240, 320), left, np.uint16)
    labels[:, 160:] = right
    return labels


def test_vertices_have_the_class_that_was_seen_most() -> None:
    volume = TsdfVolume(TsdfConfig(semantic=True))
    for labels in (halves(3, 9), halves(3, 9), halves(3, 5), halves(0, 0)):
        volume.integrate(GROUND_M, None, CAMERA, ABOVE, labels)
    mesh = volume.extract_mesh()
    T_camera_map = invert(ABOVE)
    x = (mesh.vertices_m @ T_camera_map[:3, :3].T + T_camera_map[:3, 3])[:, 0]
    assert mesh.class_ids is not None
    assert mesh.class_probabilities is not None
    assert mesh.class_ids.dtype == np.uint16
    assert (mesh.class_ids[x < -0.15] == 3).all()
    assert (mesh.class_ids[x > 0.15] == 9).all()
    np.testing.assert_allclose(mesh.class_probabilities[x < -0.15], 1.0)
    np.testing.assert_allclose(mesh.class_probabilities[x > 0.15], 2 / 3, rtol=1e-5)
    points_m = np.array([(0.0, 0.0, 9.0), *mesh.vertices_m[::50]])
    ids, shares = volume.classes_at(points_m)
    assert (ids[0], shares[0]) == (0, 0)
    away = np.abs(x[::50]) > 0.25
    assert np.array_equal(ids[1:][away], mesh.class_ids[::50][away])
    np.testing.assert_allclose(shares[1:][away], mesh.class_probabilities[::50][away], rtol=1e-5)


def test_unlabelled_volumes_say_so() -> None:
    volume = TsdfVolume()
    volume.integrate(GROUND_M, None, CAMERA, ABOVE, halves(1, 2))
    assert volume.extract_mesh().class_ids is None
    with pytest.raises(InvalidInputError, match="semantic"):
        volume.classes_at(np.array([(0.0, 0.0, 0.0)]))


def test_the_heaviest_class_is_found_among_more_than_are_kept() -> None:
    """Against plain counting, where one class has more than a quarter of the weight."""
    rng = np.random.default_rng(3)
    voxels, rounds = 200, 60
    ids = np.zeros((voxels, CLASSES_KEPT), np.uint16)
    weights = np.zeros((voxels, CLASSES_KEPT), np.float32)
    counts = np.zeros((voxels, 20))
    for _ in range(rounds):
        labels = np.where(rng.uniform(size=voxels) < 0.5, 7, rng.integers(1, 20, voxels))
        ones = np.ones(voxels, np.float32)
        fuse_classes(ids, weights, np.arange(voxels), labels.astype(np.uint16), ones)
        counts[np.arange(voxels), labels] += 1
    found, share = most_likely(ids, weights)
    assert np.array_equal(found, counts.argmax(axis=1))
    np.testing.assert_allclose(weights.sum(axis=1), rounds)
    assert (share >= counts.max(axis=1) / rounds - 1e-6).all()


def test_colours_of_classes_differ() -> None:
    colors = {class_color(number) for number in range(40)}
    assert len(colors) == 40
    assert class_color(0) == (128, 128, 128)


def test_classes_are_kept_in_ply_files(tmp_path: Path) -> None:
    mesh = fly(TsdfVolume(TsdfConfig(semantic=True)), flight(2)).extract_mesh()
    write_ply(tmp_path / "m.ply", mesh, {2: "wet  sand", 1: "Fels"})
    back = read_ply(tmp_path / "m.ply")
    assert np.array_equal(back.class_ids, mesh.class_ids)  # type: ignore[arg-type]
    assert np.array_equal(back.class_probabilities, mesh.class_probabilities)  # type: ignore[arg-type]
    np.testing.assert_allclose(back.vertices_m, mesh.vertices_m, atol=1e-5)
    assert read_class_names(tmp_path / "m.ply") == {1: "Fels", 2: "wet sand"}


@pytest.mark.parametrize(
    ("field", "value"), [("weighting", "heavy"), ("when_full", "explode"), ("max_weight", 0.0)]
)
def test_choices_that_there_are_not_are_refused(field: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=field):
        TsdfConfig(**{field: value})


def _shifted(x_m: float, y_m: float, z_m: float) -> FloatArray:
    """Return what moves a camera's view of the origin's sphere to another centre."""
    T = np.eye(4)
    T[:3, 3] = ABOVE[:3, :3].T @ (x_m, y_m, z_m)
    return T
