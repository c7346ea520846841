"""Integration of views: agreement with Open3D, free-space clearing, weights."""

from typing import Any

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial import cKDTree
from synthetic_views import CAMERA, UP, camera_at, plane_depth_m, same_mesh, sphere_depth_m

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume

ABOVE = camera_at((0.01, 0, 6), (0, 0, 0))
GROUND_M = plane_depth_m(ABOVE, UP, 0.0)
SKY_M = np.full((240, 320), np.inf, np.float32)


@pytest.mark.parametrize(("views", "usual_m", "mean_m"), [(1, 1e-4, 2e-3), (6, 2e-3, 1e-2)])
def test_geometry_agrees_with_open3d_on_the_same_views(
    views: int, usual_m: float, mean_m: float
) -> None:
    """Nearly equal for one view; for several, only ours weighs by what each could see."""
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


@pytest.mark.parametrize("beyond", ["ground", "sky"])
def test_an_object_that_moved_away_disappears(beyond: str) -> None:
    volume = TsdfVolume(TsdfConfig(max_range_m=20.0))
    with_ball_m = np.minimum(GROUND_M, sphere_depth_m(ABOVE @ _shifted(0, 0, -2), 0.7))
    away_m = GROUND_M if beyond == "ground" else SKY_M
    for depth_m in (with_ball_m, with_ball_m, away_m, away_m, away_m):
        volume.integrate(depth_m, None, CAMERA, ABOVE)
    heights_m = volume.extract_mesh().vertices_m[:, 2]
    assert (heights_m < 0.5).all()
    if beyond == "ground":
        assert len(heights_m) > 1000


def test_an_object_that_moved_away_stays_without_clearing() -> None:
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


def test_invalid_pixels_clear_nothing() -> None:
    volume = TsdfVolume()
    volume.integrate(GROUND_M, None, CAMERA, ABOVE)
    before = volume.extract_mesh()
    for nothing in (np.nan, -np.inf, 0.0, -1.0):
        volume.integrate(np.full((240, 320), nothing, np.float32), None, CAMERA, ABOVE)
    assert same_mesh(before, volume.extract_mesh())


def test_near_pixels_weigh_more_by_the_inverse_square() -> None:
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


def test_slanting_rays_weigh_less_by_incidence() -> None:
    """A plane seen 0.1 m too high from straight above, and 0.1 m too low at 60 degrees."""
    volume = TsdfVolume(TsdfConfig(weigh_incidence=True, truncation_voxels=6.0))
    slanting = camera_at((5.2, 0, 3), (0, 0, 0))
    for T, offset_m in ((ABOVE, 0.1), (slanting, -0.1)):
        volume.integrate(plane_depth_m(T, UP, offset_m), None, CAMERA, T)
    vertices_m = volume.extract_mesh().vertices_m
    middle = np.abs(vertices_m[:, :2]).max(axis=1) < 0.3
    # Along the slanting ray a height of h is h / cos(60 deg) = 2 h, at half the weight.
    assert vertices_m[middle, 2].mean() == pytest.approx(0.0, abs=0.02)


def test_limited_weights_let_voxels_adapt_to_changes() -> None:
    higher_m = plane_depth_m(ABOVE, UP, 0.1)
    heights_m = {}
    for max_weight in (4.0, 1000.0):
        volume = TsdfVolume(TsdfConfig(max_weight=max_weight))
        for depth_m in [GROUND_M] * 20 + [higher_m] * 10:
            volume.integrate(depth_m, None, CAMERA, ABOVE)
        heights_m[max_weight] = volume.extract_mesh().vertices_m[:, 2].mean()
    assert heights_m[4.0] > 0.08
    assert heights_m[1000.0] == pytest.approx(0.1 / 3, abs=0.01)


@pytest.mark.parametrize(
    ("field", "value"), [("weighting", "heavy"), ("when_full", "explode"), ("max_weight", 0.0)]
)
def test_unknown_choices_are_refused(field: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=field):
        TsdfConfig(**{field: value})


def _shifted(x_m: float, y_m: float, z_m: float) -> FloatArray:
    """Return the transform that moves the sphere in the view of `ABOVE` to another centre."""
    T = np.eye(4)
    T[:3, 3] = ABOVE[:3, :3].T @ (x_m, y_m, z_m)
    return T
