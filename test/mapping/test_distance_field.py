"""Distances to reconstructed planes and spheres against their closed forms."""

import numpy as np
import pytest
from synthetic_views import CAMERA, UP, camera_at, plane_depth_m, sphere_depth_m

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.distance_field import distance_field
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume


def over_a_plane(normal: np.ndarray, offset_m: float) -> TsdfVolume:
    volume = TsdfVolume(TsdfConfig(max_range_m=12.0, record_free_space=True))
    T = camera_at((0.01, 0, 8), (0, 0, 0))
    volume.integrate(plane_depth_m(T, normal, offset_m), None, CAMERA, T)
    return volume


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_distances_over_a_plane_are_exact(tilt_deg: float) -> None:
    tilt = np.radians(tilt_deg)
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    field = distance_field(over_a_plane(normal, 0.037), (-3, -3, -1.5), (3, 3, 4))

    points_m = np.random.default_rng(0).uniform((-0.5, -0.5, 0), (0.5, 0.5, 1.8), (500, 3))
    found_m, true_m = field.at(points_m), points_m @ normal - 0.037

    known = np.isfinite(found_m)
    assert known.mean() > 0.95
    # A tilted plane's nearest voxel is off by up to half a voxel's diagonal.
    allowed_m = 0.01 if tilt_deg == 0 else 0.06
    assert np.abs(found_m - true_m)[known].max() < allowed_m


def test_distances_inside_and_outside_a_sphere_are_exact() -> None:
    volume = TsdfVolume(TsdfConfig(voxel_size_m=0.05, max_range_m=8.0, record_free_space=True))
    for azimuth_rad in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        for height_m in (-3.0, 3.0):
            eye_m = (5 * np.cos(azimuth_rad), 5 * np.sin(azimuth_rad), height_m)
            T = camera_at(eye_m, (0, 0, 0))
            volume.integrate(sphere_depth_m(T, 1.5), None, CAMERA, T)
    field = distance_field(volume, (-2.5, -2.5, -2.5), (2.5, 2.5, 2.5))
    directions = np.random.default_rng(1).normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    for radius_m in (1.45, 1.55, 1.9, 2.3):
        found_m = field.at(directions * radius_m)
        known = np.isfinite(found_m)
        assert known.mean() > 0.8
        assert np.abs(found_m[known] - (radius_m - 1.5)).max() < 0.05
        assert abs((found_m[known] - (radius_m - 1.5)).mean()) < 0.02


def test_unknown_space_has_no_distance_or_is_an_obstacle_on_request() -> None:
    volume = over_a_plane(UP, 0.0)
    far_aside = [(50.0, 50.0, 1.0)]
    field = distance_field(volume, (-2, -2, -2), (2, 2, 3))
    assert np.isnan(field.at(far_aside)).all()
    assert np.isnan(field.at([(0.0, 0.0, -1.5)])).all()
    # The view is a pyramid: at 3 m over the ground it ends some 2 m aside.
    wide = distance_field(volume, (-6, -6, -1), (6, 6, 5))
    careful = distance_field(volume, (-6, -6, -1), (6, 6, 5), unknown_is_occupied=True)
    free = np.isfinite(wide.distance_m) & (wide.distance_m > 0)
    assert (careful.distance_m[free] <= wide.distance_m[free]).all()
    assert (careful.distance_m[free] < wide.distance_m[free] - 0.5).any()


def test_open_space_is_unknown_without_recorded_free_space() -> None:
    volume = TsdfVolume()
    T = camera_at((0.01, 0, 8), (0, 0, 0))
    volume.integrate(plane_depth_m(T, UP, 0.0), None, CAMERA, T)
    field = distance_field(volume, (-1, -1, -1), (1, 1, 4))
    near_m, far_m = field.at([(0.0, 0.0, 0.2), (0.0, 0.0, 3.0)])
    # This surface lies on voxels, which are on either side of it by rounding: half a voxel.
    assert near_m == pytest.approx(0.2, abs=0.05)
    assert np.isnan(far_m)


def test_a_slice_contains_the_distances_at_its_height() -> None:
    field = distance_field(over_a_plane(UP, 0.02), (-1, -1, -0.5), (1, 1.5, 2))
    flat_m = field.slice_at(1.03)
    assert flat_m.shape == (21, 26)
    np.testing.assert_allclose(flat_m, 1.01, atol=0.01)
    with pytest.raises(InvalidInputError, match="height_m"):
        field.slice_at(2.5)


def test_an_empty_box_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="region"):
        distance_field(TsdfVolume(), (1, 1, 1), (0, 0, 0))
    assert np.isnan(distance_field(TsdfVolume(), (0, 0, 0), (1, 1, 1)).distance_m).all()
