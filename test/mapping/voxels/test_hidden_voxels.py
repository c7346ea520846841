"""Voxels hidden behind the surface that a view shows."""

import numpy as np
import open3d as o3d
import pytest
from surfaces import depth_seen, grid_mesh
from synthetic_views import CAMERA, UP, camera_at, plane_depth_m

from oaisys_core.types import TriangleMesh
from oaisys_mapping.evaluation.visibility import PosedCamera, raycasting_scene
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume

ABOVE = camera_at((0.01, 0, 6), (0, 0, 0))


@pytest.mark.parametrize(
    ("height_m", "counts"), [(0.1, 1.0), (0.12, 0.6), (0.14, 0.2), (0.2, 1e-3), (0.28, 1e-3)]
)
def test_measurements_weigh_less_behind_the_surface(height_m: float, counts: float) -> None:
    """Ground seen at 0 m and once higher; truncation 0.3 m, weights fall from 0.1 to 0.15 m.

    The voxel at the origin is 0 m in front of one surface, and ``height_m`` behind the other.
    """
    volume = TsdfVolume(TsdfConfig())
    for offset_m in (0.0, height_m):
        volume.integrate(plane_depth_m(ABOVE, UP, offset_m), None, CAMERA, ABOVE)
    expected_m = -height_m * counts / (1 + counts)
    assert volume.distance_at(np.zeros((1, 3)))[0] == pytest.approx(expected_m, abs=1e-4)


def test_voxels_close_behind_a_surface_are_solid_until_observed() -> None:
    """Truncated at 0.3 m; solid, but not observed, down to 0.5 m."""
    volume = TsdfVolume(TsdfConfig())
    volume.integrate(plane_depth_m(ABOVE, UP, 0.001), None, CAMERA, ABOVE)
    heights_m = np.array((-0.2, -0.3, -0.4, -0.5))
    points_m = np.column_stack((np.zeros((4, 2)), heights_m))
    expected_m = (-0.201, -0.3, -0.3, np.nan)
    assert volume.distance_at(points_m) == pytest.approx(expected_m, abs=1e-4, nan_ok=True)
    column = volume.observations(np.array((0, 0, -6)), np.array((1, 1, 0)))
    assert column.is_known.ravel().tolist() == [False, False, False, False, True, True]
    low_m = plane_depth_m(ABOVE, UP, -0.6)
    volume.integrate(low_m, None, CAMERA, ABOVE)
    assert volume.distance_at(points_m[1:3])[1] == pytest.approx(0.2, abs=1e-3)


def test_a_face_at_grazing_angles_has_no_hole() -> None:
    """A step of 0.45 m beside a camera 6 m above: its face is as wide as three pixels."""
    face_m = 0.71
    low, high = (
        grid_mesh((-2, face_m), (-2, 2), 0.0),
        grid_mesh((face_m, 2), (-2, 2), 0.45),
    )
    corners_m = [(face_m, -2, 0), (face_m, -2, 0.45), (face_m, 2, 0.45), (face_m, 2, 0)]
    parts = (low, high, (np.array(corners_m), np.array([(0, 2, 1), (0, 3, 2)], np.int32)))
    first = np.cumsum([0, *(len(vertices_m) for vertices_m, _ in parts)])
    vertices_m = np.concatenate([one for one, _ in parts])
    triangles = np.concatenate([one + f for (_, one), f in zip(parts, first, strict=False)])
    truth = TriangleMesh(vertices_m, triangles.astype(np.int32))
    volume = TsdfVolume()
    volume.integrate(depth_seen(truth, PosedCamera(CAMERA, ABOVE)), None, CAMERA, ABOVE)
    mesh = volume.extract_mesh()
    scene = raycasting_scene(mesh.vertices_m, mesh.triangles)
    y_m, z_m = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(0, 0.45, 19))
    points_m = np.column_stack((np.full(y_m.size, face_m), y_m.ravel(), z_m.ravel()))
    away_m = scene.compute_distance(o3d.core.Tensor(points_m.astype(np.float32))).numpy()
    assert away_m.max() < 0.08
