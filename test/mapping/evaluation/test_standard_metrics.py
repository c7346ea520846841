"""The standard metrics against closed forms and independent libraries."""

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from surfaces import colored, down, grid_mesh, hills, sphere

from oaisys_core.types import FloatArray, TriangleMesh
from oaisys_mapping.evaluation.evaluate import Extras, evaluate_reconstruction
from oaisys_mapping.evaluation.metrics import ReconstructionMetrics
from oaisys_mapping.evaluation.semantics import class_agreement
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh

VOXEL_M = 0.10


def measure(
    mesh: ColoredMesh,
    truth: TriangleMesh,
    views: list[PosedCamera] | None = None,
    extras: Extras | None = None,
) -> ReconstructionMetrics:
    rng = np.random.default_rng(0)
    return evaluate_reconstruction(mesh, truth, views, VOXEL_M, 60.0, rng, extras).metrics


def spread(vertices_m: FloatArray, triangles: NDArray[np.int32], count: int) -> FloatArray:
    """Points on a mesh, by Open3D."""
    o3d.utility.random.seed(3)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices_m), o3d.utility.Vector3iVector(triangles)
    )
    return np.asarray(mesh.sample_points_uniformly(count).points)


def test_distances_agree_with_open3d_and_scipy() -> None:
    """A sphere against a larger, shifted one, by dense points."""
    true, made = sphere(2.0, np.zeros(3)), sphere(2.1, np.array((0.15, 0.0, 0.1)))
    figures = measure(colored(*made), TriangleMesh(*true))
    true_m, made_m = spread(*true, 150_000), spread(*made, 150_000)
    to_true_m, _ = cKDTree(true_m).query(made_m[:50_000])
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in (true_m, made_m)]
    to_made_m = np.asarray(clouds[0].compute_point_cloud_distance(clouds[1]))
    assert figures.accuracy_mean_m == pytest.approx(to_true_m.mean(), abs=2e-3)
    assert figures.accuracy_median_m == pytest.approx(np.median(to_true_m), abs=2e-3)
    assert figures.rmse_m == pytest.approx(np.sqrt((to_true_m**2).mean()), abs=2e-3)
    assert figures.completion_mean_m == pytest.approx(to_made_m.mean(), abs=2e-3)
    assert figures.chamfer_m == pytest.approx((to_true_m.mean() + to_made_m.mean()) / 2, abs=2e-3)
    assert figures.completion_ratio == pytest.approx((to_made_m <= 0.1).mean(), abs=5e-3)
    assert figures.precision == pytest.approx((to_true_m <= 0.1).mean(), abs=5e-3)


def test_concentric_spheres_have_closed_forms() -> None:
    figures = measure(colored(*sphere(2.06, np.zeros(3))), TriangleMesh(*sphere(2.0, np.zeros(3))))
    for value in (figures.accuracy_mean_m, figures.rmse_m, figures.chamfer_m):
        assert value == pytest.approx(0.06, abs=1e-3)
    assert figures.offset_m == pytest.approx(0.0, abs=1e-3)


def test_f_scores_at_any_tolerance() -> None:
    truth = TriangleMesh(*grid_mesh((-4, 4), (-4, 4), 0.0))
    half = colored(*grid_mesh((-4, 0), (-4, 4), 0.03))
    low, high = measure(half, truth, extras=Extras(taus_m=(0.02, 0.05))).f_scores
    assert (low.precision, low.completion, low.f_score) == (0.0, 0.0, 0.0)
    assert high.precision == 1.0
    # Beyond the edge, what is within 5 cm of it counts as well: 4 cm along the ground.
    assert high.completion == high.completion_all == pytest.approx(0.505, abs=2e-3)
    assert high.f_score == pytest.approx(2 * high.completion / (1 + high.completion))


def test_completeness_is_given_for_the_visible_and_for_all_truth() -> None:
    """Ground of which one view sees a part, and a map of exactly that part."""
    vertices_m, triangles = grid_mesh((-10, 10), (-10, 10), 0.0)
    view = down(0.0, 0.0, 6.0)
    seen_m2 = (159 / 135.285 * 6) * (119 / 135.285 * 6)
    inside = (np.abs(vertices_m[triangles].mean(axis=1)[:, :2]) < (2.7, 3.6)).all(axis=1)
    made = colored(vertices_m, triangles[inside])
    made_m2 = inside.sum() * 0.005
    figures = measure(made, TriangleMesh(vertices_m, triangles), [view])
    assert figures.visible_share == pytest.approx(seen_m2 / 400, rel=0.01)
    assert figures.completion_ratio == 1.0
    around_m2 = (5.4 + 7.2) * 2 * VOXEL_M
    expected = (made_m2 + around_m2) / 400
    assert figures.completion_ratio_all == pytest.approx(expected, rel=0.02)
    assert figures.f_score_all == pytest.approx(2 * expected / (1 + expected), rel=0.02)
    assert figures.completion_mean_m < 1e-3 < 1.0 < figures.completion_mean_all_m
    assert figures.gap_ratio_all == pytest.approx(1 - made_m2 / 400, rel=0.02)


@pytest.mark.parametrize(
    "shift_m", [(0.02, 0, 0), (0, -0.02, 0), (0, 0, 0.02), (0.03, 0.01, -0.02)]
)
def test_the_offset_of_a_shifted_map_is_measured(shift_m: tuple[float, float, float]) -> None:
    vertices_m, triangles = hills(6.0)
    made = colored(vertices_m + np.array(shift_m), triangles)
    figures = measure(made, TriangleMesh(vertices_m, triangles))
    assert figures.offset_xyz_m == pytest.approx(shift_m, abs=1e-3)
    assert figures.offset_m == pytest.approx(np.linalg.norm(shift_m), abs=1e-3)


def test_a_shift_along_a_plane_is_not_an_offset() -> None:
    plane = grid_mesh((-4, 4), (-4, 4), 0.0)
    shifted_m = plane[0] + np.array((0.05, 0.05, 0.01))
    figures = measure(colored(shifted_m, plane[1]), TriangleMesh(*plane))
    assert figures.offset_xyz_m == pytest.approx((0, 0, 0.01), abs=1e-5)


def test_holes_are_counted_but_slits_within_a_voxel_are_not() -> None:
    """Two square holes and a slit of 24 cm count as holes; a slit of 16 cm does not."""
    vertices_m, triangles = grid_mesh((-4, 4), (-4, 4), 0.0, 0.02)
    x, y = vertices_m[triangles].mean(axis=1)[:, :2].T
    holes = ((np.abs(x - 2) < 0.5) & (np.abs(y) < 0.5)) | ((np.abs(x + 2) < 1) & (np.abs(y) < 1))
    wide = (np.abs(x) < 3) & (np.abs(y - 3) < 0.12)
    narrow = (np.abs(x) < 3) & (np.abs(y + 3) < 0.08)
    truth = TriangleMesh(vertices_m, triangles)
    figures = measure(colored(vertices_m, triangles[~(holes | wide | narrow)]), truth)
    assert figures.hole_count == figures.overlap_hole_count == 3
    assert figures.hole_area_m2 == pytest.approx(5.0 + 6 * 0.24, rel=0.02)
    assert figures.largest_hole_m2 == pytest.approx(4.0, rel=0.02)
    assert figures.hole_ratio == pytest.approx((5.0 + 6 * 0.24) / 7.6**2, rel=0.02)
    assert figures.gap_ratio == pytest.approx((5.0 + 6 * 0.4) / 7.6**2, rel=0.02)


def test_truth_further_than_a_voxel_lies_in_a_hole() -> None:
    """A plane reconstructed 15 cm too high in one place: a hole without a gap."""
    vertices_m, triangles = grid_mesh((-4, 4), (-4, 4), 0.0, 0.05)
    raised_m = vertices_m.copy()
    raised_m[np.abs(vertices_m[:, :2]).max(axis=1) < 0.9, 2] = 0.15
    figures = measure(colored(raised_m, triangles), TriangleMesh(vertices_m, triangles))
    assert figures.gap_ratio == 0
    assert figures.overlap_hole_count == 1
    assert figures.overlap_farthest_m == pytest.approx(0.15, abs=1e-6)


@pytest.mark.parametrize("across_m", [7.9, 8.0, 8.1, 8.2])
def test_the_rim_is_two_voxels_wide_however_large_the_area(across_m: float) -> None:
    plane = grid_mesh((0, across_m), (0, across_m), 0.0)
    figures = measure(colored(*plane), TriangleMesh(*plane))
    inner_m = across_m - 4 * VOXEL_M
    assert figures.overlap_area_m2 == pytest.approx(inner_m**2, rel=0.015)


def test_a_hole_outside_the_overlap_does_not_count_there() -> None:
    """Two views side by side share a strip; the hole is where only one of them sees."""
    vertices_m, triangles = grid_mesh((-8, 8), (-8, 8), 0.0)
    views = [down(0.0, -2.0, 6.0), down(0.0, 2.0, 6.0)]
    across_m, along_m = 119 / 135.285 * 6, 159 / 135.285 * 6
    truth = TriangleMesh(vertices_m, triangles)

    def with_hole_at(y_m: float) -> ReconstructionMetrics:
        centre_m = vertices_m[triangles].mean(axis=1)[:, :2] - (0.0, y_m)
        kept = np.abs(centre_m).max(axis=1) > 0.4
        return measure(colored(vertices_m, triangles[kept]), truth, views)

    outside, inside = with_hole_at(-3.5), with_hole_at(0.0)
    assert (outside.hole_count, outside.overlap_hole_count) == (1, 0)
    assert (inside.hole_count, inside.overlap_hole_count) == (1, 1)
    assert inside.overlap_hole_area_m2 == pytest.approx(0.64, rel=0.1)
    strip_m2 = (along_m - 4) * (across_m - 4 * VOXEL_M)
    assert inside.overlap_area_m2 == pytest.approx(strip_m2, rel=0.08)


class Shifted:
    """Distances to a plane at 0.04 m, known where x is below 2."""

    volume_observed_m3 = 7.0

    def distance_at(self, points_m: FloatArray) -> FloatArray:
        distance_m = points_m[:, 2] - 0.04
        return np.where(points_m[:, 0] < 2, distance_m, np.nan)


def test_distances_at_the_truth_are_evaluated_as_in_voxblox() -> None:
    low = grid_mesh((-4, 0), (-4, 4), 0.0)
    high = grid_mesh((0, 4), (-4, 4), 1.0)
    truth = TriangleMesh(np.vstack((low[0], high[0])), np.vstack((low[1], high[1] + len(low[0]))))
    figures = measure(colored(*low), truth, extras=Extras(volume=Shifted())).tsdf
    assert figures is not None
    assert figures.tsdf_rmse_m is not None
    # Two thirds of what is known are 0.04 m off; the rest, 0.96 m off, counts as three voxels.
    expected_m = np.sqrt((2 * 0.04**2 + 0.3**2) / 3)
    assert figures.tsdf_rmse_m == pytest.approx(expected_m, rel=5e-3)
    assert figures.unknown_share == pytest.approx(0.25, abs=5e-3)
    assert figures.unknown_share_all == pytest.approx(figures.unknown_share)
    assert figures.observed_volume_m3 == 7.0


def test_iou_of_a_shifted_class_border() -> None:
    """Truth changes at x = 0, the map at x = 0.5."""
    vertices_m, triangles = grid_mesh((-4, 4), (-4, 4), 0.0)
    x_m = vertices_m[triangles].mean(axis=1)[:, 0]
    truth = TriangleMesh(vertices_m, triangles, np.where(x_m < 0, 3, 7).astype(np.uint16))
    ids = np.where(vertices_m[:, 0] < 0.499, 3, 7).astype(np.uint16)
    made = ColoredMesh(vertices_m, triangles, np.zeros_like(vertices_m, np.uint8), ids)
    figures = measure(made, truth, extras=Extras(labels={3: "sand"}))
    assert figures.classes is not None
    # A place has its nearest corner's label. Of the corners' last row at 0.4 m that is up to
    # 0.45 m, but in triangles with one corner in it only as far as the middle of their sides.
    assert figures.classes.iou == pytest.approx({"sand": 4 / 4.45, "7": 3.55 / 4}, abs=8e-3)
    assert figures.classes.share == pytest.approx({"sand": 0.5, "7": 0.5}, abs=1e-3)
    assert figures.least_iou == pytest.approx(3.55 / 4, abs=8e-3)
    assert Thresholds(min_iou=0.9).misses_of(figures)


def test_iou_counts_missing_labels_and_ignores_rare_classes() -> None:
    true_ids = np.array([1] * 995 + [2] * 5 + [0] * 100)
    map_ids = np.array([1] * 900 + [0] * 100 + [1] * 100)
    found = class_agreement(true_ids, map_ids, {1: "soil", 2: "ice"})
    assert found.iou == pytest.approx({"soil": 900 / 995, "ice": 0.0})
    assert found.least == pytest.approx(900 / 995), "ice has half a percent of the surface"
