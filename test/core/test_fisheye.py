"""Fisheye cameras agree with OpenCV's model, in front of them and behind."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from synthetic_worlds import camera, flat_world, settings

from oaisys_core import geometry
from oaisys_core.config import CameraConfig, config_from_mapping
from oaisys_core.errors import ConfigError
from oaisys_core.output.records import intrinsics_from_record, intrinsics_record
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.types import EQUIDISTANT, PinholeIntrinsics, Pose

LENSES = {
    "equidistant": (),
    "barrel": (-0.02, 0.006, -0.002, 0.0004),
    "cushion": (0.05, -0.02, 0.004, -0.0005),
}
WIDE = PinholeIntrinsics(120, 90, 52.0, 55.0, 61.3, 40.2, (), EQUIDISTANT)
"""Sees up to about 85 degrees off its axis."""

BEHIND = PinholeIntrinsics(96, 72, 24.0, 24.0, 47.5, 35.5, LENSES["barrel"], EQUIDISTANT)
"""Sees more than 120 degrees off its axis in its corners."""


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_points_and_rays_are_those_of_opencv(lens: tuple[float, ...]) -> None:
    intrinsics = replace(WIDE, distortion=lens)
    coefficients = np.array(lens or (0.0,) * 4)
    rays = geometry.pixel_rays(intrinsics)
    assert np.allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-14)
    front = rays[rays[..., 2] > 0.05]
    pixels, _ = cv2.fisheye.projectPoints(
        4 * front.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), intrinsics.K, coefficients
    )
    v, u = np.nonzero(rays[..., 2] > 0.05)
    np.testing.assert_allclose(pixels[:, 0], np.column_stack((u, v)), atol=1e-9)
    np.testing.assert_allclose(geometry.project(4 * front, intrinsics), pixels[:, 0], atol=1e-9)


@pytest.mark.parametrize("intrinsics", [WIDE, BEHIND], ids=["wide", "behind"])
def test_pixels_beyond_90_degrees_lead_back_to_themselves(intrinsics: PinholeIntrinsics) -> None:
    rays = geometry.pixel_rays(intrinsics)
    if intrinsics is BEHIND:
        assert rays[..., 2].min() < -0.5
    v, u = np.mgrid[: intrinsics.height_px, : intrinsics.width_px]
    pixels = np.stack((u, v), axis=-1).reshape(-1, 2).astype(float)
    np.testing.assert_allclose(
        geometry.project(3 * rays.reshape(-1, 3), intrinsics), pixels, atol=1e-9
    )
    depth_m = np.random.default_rng(1).uniform(1, 9, len(pixels))
    points_m = geometry.unproject(pixels, depth_m, intrinsics)
    np.testing.assert_allclose(geometry.depth_along_ray_m(points_m, intrinsics), depth_m)
    image = depth_m.reshape(rays.shape[:2]).astype(np.float32)
    there_m = geometry.depth_to_points(image, intrinsics)
    np.testing.assert_allclose(there_m.reshape(-1, 3), points_m, atol=1e-5)


def test_the_axis_is_the_principal_point() -> None:
    centred = replace(WIDE, cx_px=60.0, cy_px=44.0)
    np.testing.assert_array_equal(geometry.pixel_rays(centred)[44, 60], (0.0, 0.0, 1.0))
    np.testing.assert_array_equal(geometry.project([(0.0, 0.0, 2.0)], centred), [(60.0, 44.0)])


def test_depth_of_a_plane_is_the_range_along_each_ray_also_behind_the_camera() -> None:
    level = camera(Pose((0.5, -1.0, 3.0), (0.0, 0.0, 0.0, 1.0)), BEHIND)
    level = replace(level, modalities=("depth", "range", "normal", "semantic_0"))
    backend = AnalyticBackend()
    backend.build(replace(flat_world(), primitives=()), lambda _: None)
    depth, range_, normal, label = (
        frame.data for frame in backend.render_all([level], settings(), lambda _: None)
    )
    directions = geometry.pixel_rays(BEHIND) @ level.T_map_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        expected_m = (0.25 - 3.0) / directions[..., 2]
    with np.errstate(invalid="ignore"):
        xy_m = np.array((0.5, -1.0)) + expected_m[..., None] * directions[..., :2]
    on_ground = (expected_m > 0) & (np.abs(xy_m) < 20).all(axis=-1)
    np.testing.assert_array_equal(np.isfinite(depth), on_ground)
    np.testing.assert_allclose(depth[on_ground], expected_m[on_ground], rtol=1e-6)
    np.testing.assert_array_equal(depth, range_)
    behind = on_ground & (geometry.pixel_rays(BEHIND)[..., 2] < -0.1)
    assert behind.sum() > 100
    up = level.T_map_camera[:3, :3].T @ (0.0, 0.0, 1.0)
    np.testing.assert_allclose(normal[on_ground], np.tile(up, (on_ground.sum(), 1)), atol=1e-6)
    assert set(np.unique(label[on_ground])) <= {1, 2}


def test_flow_of_a_turn_is_known_where_the_camera_looks_back() -> None:
    pose = Pose((0.0, 0.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    before = Pose((0.3, 0.1, 3.2), (0.0, 0.0, np.sin(0.05), np.cos(0.05)))
    now, then = (camera(each, BEHIND, ("depth", "flow")) for each in (pose, before))
    now = replace(now, T_map_previous=then.T_map_camera)
    backend = AnalyticBackend()
    backend.build(replace(flat_world(), primitives=()), lambda _: None)
    depth, flow = (f.data for f in backend.render_all([now], settings(), lambda _: None))
    seen = np.isfinite(depth)
    rays = geometry.pixel_rays(BEHIND)
    points_m = rays[seen] * depth[seen, None].astype(float)
    T = geometry.invert(then.T_map_camera) @ now.T_map_camera
    pixels = geometry.project(points_m @ T[:3, :3].T + T[:3, 3], BEHIND)
    v, u = np.nonzero(seen)
    np.testing.assert_allclose(flow[seen], np.column_stack((u, v)) - pixels, atol=1e-4)
    assert np.isfinite(flow).all()


def fisheye(**keys: Any) -> dict[str, Any]:
    return {"width_px": 64, "height_px": 48, "fx_px": 24.0, "fy_px": 24.0, "fisheye": {}, **keys}


def test_the_configuration_and_its_record_give_the_model() -> None:
    config = CameraConfig.model_validate(fisheye(fisheye={"k1": 0.01, "k3": -0.002}))
    assert config.intrinsics.distortion == (0.01, 0.0, -0.002, 0.0)
    assert config.intrinsics.is_fisheye
    assert not config.intrinsics.is_rectilinear
    assert intrinsics_from_record(intrinsics_record(config.intrinsics)) == config.intrinsics


def test_records_without_a_model_are_of_pinhole_cameras() -> None:
    record = intrinsics_record(CameraConfig().intrinsics)
    del record["distortion_model"]
    assert intrinsics_from_record(record) == CameraConfig().intrinsics


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"fisheye": {"k1": -0.2}}, "fisheye is not invertible"),
        ({"fx_px": 8.0}, "fisheye is not invertible"),
        ({"distortion": {"k1": 0.1}}, "distortion must be null"),
        ({"lens": {}}, "lens must be null"),
        ({"cx_px": 70.0}, "inside the image"),
        ({"modalities": ["disparity"]}, "disparity needs"),
    ],
)
def test_what_a_fisheye_cannot_have_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        config_from_mapping({"sensors": {"cameras": [fisheye(**keys)]}})
