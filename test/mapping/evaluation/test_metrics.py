"""Figures of constructed reconstructions whose errors are known."""

import numpy as np
import open3d as o3d
import pytest
from surfaces import CAMERA, colored, down, grid_mesh, sphere

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import (
    T_LINK_OPTICAL,
    pixel_rays,
    pose_looking_at,
    pose_to_matrix,
)
from oaisys_core.types import PinholeIntrinsics, TriangleMesh
from oaisys_mapping.evaluation.evaluate import evaluate_reconstruction
from oaisys_mapping.evaluation.metrics import ReconstructionMetrics
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh, sample_surface, triangle_areas_m2
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume

VOXEL_M = 0.10
IMAGE_AT_6_M_M2 = (159 / 135.285 * 6) * (119 / 135.285 * 6)
"""What the camera sees of level ground 6 m below, from the first pixel's centre to the last's."""

CLOSED = Thresholds(max_rmse_m=0.05, min_completion=0.95, min_f_score=0.95)


def measure(
    mesh: ColoredMesh, truth: TriangleMesh, views: list[PosedCamera] | None = None
) -> ReconstructionMetrics:
    rng = np.random.default_rng(0)
    return evaluate_reconstruction(mesh, truth, views, VOXEL_M, 60.0, rng).metrics


def test_a_shifted_plane_is_off_by_the_shift() -> None:
    truth = TriangleMesh(*grid_mesh((-4, 4), (-4, 4), 0.0))
    figures = measure(colored(*grid_mesh((-4, 4), (-4, 4), 0.07)), truth)
    assert figures.rmse_m == pytest.approx(0.07, abs=1e-5)
    assert figures.accuracy_mean_m == pytest.approx(0.07, abs=1e-5)
    assert figures.completion_mean_m == pytest.approx(0.07, abs=1e-5)
    assert figures.completion_ratio == figures.precision == figures.f_score == 1.0
    assert figures.hole_ratio == 0.0
    figures = measure(colored(*grid_mesh((-4, 4), (-4, 4), 0.15)), truth)
    assert figures.f_score == 0.0
    assert figures.f_score_2 == 1.0


def test_half_a_reconstruction_completes_half_of_the_truth() -> None:
    truth = TriangleMesh(*grid_mesh((-4, 4), (-4, 4), 0.0))
    figures = measure(colored(*grid_mesh((-4, 0), (-4, 4), 0.0)), truth)
    # What lies within a voxel beyond the edge counts as well.
    assert figures.completion_ratio == pytest.approx(0.5 + 0.1 / 8, abs=2e-3)
    assert figures.precision == 1.0
    assert figures.f_score == pytest.approx(2 * 0.5125 / 1.5125, abs=3e-3)


def test_ground_beyond_the_rim_of_an_open_truth_is_not_measured() -> None:
    truth = TriangleMesh(*grid_mesh((-4, 4), (-4, 4), 0.0))
    figures = measure(colored(*grid_mesh((-4, 9), (-4, 4), 0.0)), truth)
    assert figures.past_rim_share == pytest.approx(5 / 13, abs=0.01)
    assert figures.precision == figures.f_score == 1.0
    assert figures.accuracy_max_m < 1e-6
    raised = measure(colored(*grid_mesh((-4, 9), (-4, 4), 0.07)), truth)
    assert raised.rmse_m == pytest.approx(0.07, abs=1e-5)
    around = measure(colored(*grid_mesh((-9, 9), (-9, 9), 0.02, step_m=0.13)), truth)
    assert around.past_rim_share == pytest.approx(1 - 64 / 324, abs=0.01)
    assert around.accuracy_max_m == pytest.approx(0.02, abs=1e-4)


def test_surfaces_outside_a_closed_truth_are_measured() -> None:
    centre_m = np.array((0.0, 0.0, 2.0))
    figures = measure(colored(*sphere(1.5, centre_m)), TriangleMesh(*sphere(1.0, centre_m)))
    assert figures.past_rim_share == 0.0
    assert figures.accuracy_median_m == pytest.approx(0.5, abs=0.01)


def test_a_hole_of_known_area_is_found() -> None:
    vertices_m, triangles = grid_mesh((-4, 4), (-4, 4), 0.0)
    centres_m = vertices_m[triangles].mean(axis=1)
    kept = np.abs(centres_m[:, :2]).max(axis=1) > 1.0
    figures = measure(colored(vertices_m, triangles[kept]), TriangleMesh(vertices_m, triangles))
    assert figures.surveyed_area_m2 == pytest.approx(64)
    # The rim of 2 voxels, where a missing surface is no hole, is not in the area.
    assert figures.hole_ratio == pytest.approx(4 / 7.6**2, rel=0.02)


def test_artefacts_in_the_air_count_against_accuracy() -> None:
    truth = TriangleMesh(*grid_mesh((-4, 4), (-4, 4), 0.0))
    ground, above = grid_mesh((-4, 4), (-4, 4), 0.0), grid_mesh((-1, 1), (-1, 1), 1.0)
    both = colored(
        np.vstack((ground[0], above[0])), np.vstack((ground[1], above[1] + len(ground[0])))
    )
    figures = measure(both, truth)
    assert figures.precision == pytest.approx(64 / 68, abs=2e-3)
    assert figures.rmse_m == pytest.approx(np.sqrt(4 / 68), rel=0.01)


def test_only_visible_truth_must_be_complete() -> None:
    roof, floor = grid_mesh((-1, 1), (-1, 1), 2.0), grid_mesh((-6, 6), (-6, 6), 0.0)
    truth = TriangleMesh(
        np.vstack((floor[0], roof[0])), np.vstack((floor[1], roof[1] + len(floor[0])))
    )
    view = down(0.0, 0.0, 6.0)
    figures = measure(colored(truth.vertices_m, truth.triangles), truth, [view])
    # The roof, at 4 m, hides 1.5 times its edge. The surveyed area is counted on the ground.
    expected_m2 = IMAGE_AT_6_M_M2 - 3 * 3 + 2 * 2
    assert figures.surveyed_area_m2 == pytest.approx(expected_m2, rel=0.01)
    assert figures.completion_ratio == 1.0
    only_floor = measure(colored(*floor), truth, [view])
    assert only_floor.completion_ratio == pytest.approx(1 - 4 / expected_m2, abs=0.01)


def test_views_that_see_nothing_are_an_error() -> None:
    mesh = grid_mesh((-1, 1), (-1, 1), 0.0)
    with pytest.raises(InvalidInputError, match="views"):
        measure(colored(*mesh), TriangleMesh(*mesh), [down(500.0, 0.0, 5.0)])


def test_empty_meshes_are_an_error() -> None:
    mesh = grid_mesh((-1, 1), (-1, 1), 0.0)
    with pytest.raises(InvalidInputError, match="mesh"):
        measure(colored(mesh[0], mesh[1][:0]), TriangleMesh(*mesh))


def test_samples_are_spread_by_area() -> None:
    vertices_m = np.array([(0, 0, 0), (4, 0, 0), (0, 4, 0), (9, 0, 0), (10, 0, 0), (9, 1, 0.0)])
    triangles = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
    assert triangle_areas_m2(vertices_m, triangles).tolist() == [8.0, 0.5]
    points = sample_surface(vertices_m, triangles, 1e-3, 34_000, np.random.default_rng(0))
    is_small = points.points_m[:, 0] > 5
    assert len(is_small) == 34_000
    assert is_small.sum() == pytest.approx(2000, abs=1)
    assert points.area_m2 == pytest.approx(8.5 / 34_000)
    assert np.allclose(points.points_m[~is_small].mean(axis=0), (4 / 3, 4 / 3, 0), atol=0.05)
    assert np.allclose(points.normals, (0, 0, 1))


def test_a_surface_without_area_is_an_error() -> None:
    line_m = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0.0)])
    mesh = colored(line_m, np.array([[0, 1, 2]], np.int32))
    with pytest.raises(InvalidInputError, match="area"):
        measure(mesh, TriangleMesh(*grid_mesh((-1, 1), (-1, 1), 0.0)))


@pytest.mark.long
def test_triangles_larger_than_the_view_count() -> None:
    """Two triangles make the ground, with all corners far outside of the image."""
    corners_m = np.array([(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0.0)])
    ground = TriangleMesh(corners_m, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    rock_m, rock = grid_mesh((-0.5, 0.5), (-0.5, 0.5), 0.5)
    truth = TriangleMesh(
        np.vstack((corners_m, rock_m)), np.vstack((ground.triangles, rock + 4)).astype(np.int32)
    )
    view = down(0.3, -0.2, 6.0)
    figures = measure(colored(truth.vertices_m, truth.triangles), truth, [view])
    hidden_m2 = (6 / 5.5) ** 2 - 1
    assert figures.surveyed_area_m2 == pytest.approx(IMAGE_AT_6_M_M2 - hidden_m2, rel=0.02)
    without_rock = measure(colored(*grid_mesh((-9, 9), (-9, 9), 0.0)), truth, [view])
    assert without_rock.completion_ratio == pytest.approx(
        1 - 1 / figures.surveyed_area_m2, abs=3e-3
    )


def test_truth_beyond_the_range_is_not_visible() -> None:
    floor = grid_mesh((-6, 6), (-6, 6), 0.0)
    step = grid_mesh((-1, 1), (-1, 1), 2.0)
    truth = TriangleMesh(
        np.vstack((floor[0], step[0])), np.vstack((floor[1], step[1] + len(floor[0])))
    )
    rng = np.random.default_rng(0)
    found = evaluate_reconstruction(
        colored(*step), truth, [down(0, 0, 6.0)], VOXEL_M, max_range_m=5.0, rng=rng
    )
    assert found.metrics.surveyed_area_m2 == pytest.approx(4, rel=0.02)
    assert found.metrics.completion_ratio == 1.0


def test_an_oblique_view_sees_the_near_side_of_a_ridge() -> None:
    """A ridge of 45 degrees along y, seen from the side: its far side is hidden."""
    x_m = np.array([-6.0, -2.0, 0.0, 2.0, 6.0])
    z_m = np.array([0.0, 0.0, 2.0, 0.0, 0.0])
    near, far = (np.column_stack((x_m, np.full(5, y), z_m)) for y in (-9.0, 9.0))
    strip = np.array([(i, i + 1, i + 6, i, i + 6, i + 5) for i in range(4)], np.int32)
    truth = TriangleMesh(np.vstack((near, far)), strip.reshape(-1, 3))
    T = pose_to_matrix(pose_looking_at((-5, 0, 1.5), (0, 0, 1.0))) @ T_LINK_OPTICAL
    rng = np.random.default_rng(0)
    seen = evaluate_reconstruction(
        colored(truth.vertices_m, truth.triangles),
        truth,
        [PosedCamera(CAMERA, T)],
        VOXEL_M,
        60,
        rng,
    ).visible_truth
    assert (seen.points_m[:, 0] <= 1e-6).all()
    assert (seen.normals[seen.points_m[:, 0] > -2] @ (-1, 0, 1) > 1.4).all()


@pytest.fixture(scope="module")
def rough_ground() -> TriangleMesh:
    x = np.linspace(-9, 9, 181)
    wave = np.sin(1.1 * x)[:, None] * np.cos(0.9 * x)[None, :]
    return TriangleMesh(*grid_mesh((-9, 9), (-9, 9), 0.5 * wave + 0.1 * np.sin(4 * x)[None, :]))


def survey(
    truth: TriangleMesh,
    focal_factor: float = 1.0,
    offset_m: float = 0.0,
    is_ray_length: bool = False,
) -> ReconstructionMetrics:
    """Map a ground from nine nadir views, with an error in the mapper's input."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(truth.vertices_m.astype(np.float32), truth.triangles.astype(np.uint32))
    volume = TsdfVolume(TsdfConfig(voxel_size_m=VOXEL_M))
    told = PinholeIntrinsics(
        160, 120, CAMERA.fx_px * focal_factor, CAMERA.fy_px * focal_factor, 79.5, 59.5
    )
    views = [down(x, y, 6.0) for x in (-3, 0, 3) for y in (-4, 0, 4)]
    for index, view in enumerate(views):
        T = view.T_map_camera
        rays = pixel_rays(CAMERA)
        origins = np.broadcast_to(T[:3, 3], rays.shape)
        cast = np.concatenate((origins, rays @ T[:3, :3].T), -1).astype(np.float32)
        depth_m = scene.cast_rays(o3d.core.Tensor(cast))["t_hit"].numpy()
        if is_ray_length:
            depth_m = (depth_m * np.linalg.norm(rays, axis=-1)).astype(np.float32)
        wrong = T.copy()
        wrong[2, 3] += offset_m * (-1) ** index
        volume.integrate(depth_m, None, told, wrong)
    return measure(volume.extract_mesh(), truth, views)


def test_a_true_survey_closes(rough_ground: TriangleMesh) -> None:
    figures = survey(rough_ground)
    assert CLOSED.misses_of(figures) == []
    assert figures.rmse_m < 0.02


def test_a_wrong_focal_length_is_rejected(rough_ground: TriangleMesh) -> None:
    figures = survey(rough_ground, focal_factor=1.0855)
    assert CLOSED.misses_of(figures)
    assert figures.rmse_m > 3 * survey(rough_ground).rmse_m


def test_range_taken_for_depth_is_rejected(rough_ground: TriangleMesh) -> None:
    assert len(CLOSED.misses_of(survey(rough_ground, is_ray_length=True))) == 3


def test_a_pose_error_of_2_cm_is_measured(rough_ground: TriangleMesh) -> None:
    assert survey(rough_ground, offset_m=0.02).rmse_m > 1.3 * survey(rough_ground).rmse_m


def test_missed_thresholds_are_named() -> None:
    truth = TriangleMesh(*grid_mesh((-4, 4), (-4, 4), 0.0))
    figures = measure(colored(*grid_mesh((-4, 0), (-4, 4), 0.0)), truth)
    (missed,) = Thresholds(min_completion=0.9, max_rmse_m=0.01).misses_of(figures)
    assert missed.startswith("completion_ratio is 0.51")
