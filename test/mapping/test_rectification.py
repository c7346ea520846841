"""Rectified images against closed forms and OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pixel_rays
from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.rectification import rectify, rectify_camera, rectify_labels
from oaisys_mapping.tsdf import TsdfVolume

BARREL = PinholeIntrinsics(160, 120, 130.0, 125.0, 82.0, 57.5, (-0.25, 0.06, 1e-3, -2e-3, 0.005))
CUSHION = PinholeIntrinsics(160, 120, 130.0, 125.0, 82.0, 57.5, (0.15, 0.02, 1e-3, -2e-3, 0.0))
NORMAL, OFFSET_M = np.array((0.3, -0.2, 1.0)), 8.0


def plane_depth_m(camera: PinholeIntrinsics) -> np.ndarray:
    """Planar depth of the plane ``NORMAL . p = OFFSET_M``, from the camera's frame."""
    return (OFFSET_M / (pixel_rays(camera) @ NORMAL)).astype(np.float32)


@pytest.mark.parametrize("camera", [BARREL, CUSHION], ids=["barrel", "cushion"])
def test_a_rectified_image_stays_within_the_original_field_of_view(camera):
    straight = rectify_camera(camera)

    assert straight.distortion == ()
    corners = pixel_rays(straight)[[0, 0, -1, -1, 60, 0], [0, -1, 0, -1, 0, 80]]
    bent, _ = cv2.projectPoints(
        corners, np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion)
    )
    assert (bent >= -1e-2).all()
    assert (bent <= np.array((camera.width_px - 1, camera.height_px - 1)) + 1e-2).all()


@pytest.mark.parametrize("camera", [BARREL, CUSHION], ids=["barrel", "cushion"])
def test_a_plane_stays_a_plane(camera):
    rays = pixel_rays(camera)
    rgb = np.zeros((120, 160, 3), np.uint8)
    rgb[..., 0] = np.rint(128 + 100 * rays[..., 0])

    depth_m, straight_rgb = rectify(plane_depth_m(camera), rgb, camera)

    straight = rectify_camera(camera)
    assert straight_rgb is not None
    np.testing.assert_allclose(depth_m, plane_depth_m(straight), rtol=2e-4)
    red = 128 + 100 * pixel_rays(straight)[..., 0]
    np.testing.assert_allclose(straight_rgb[..., 0], red, atol=1.1)


def test_depth_is_never_mixed_between_surfaces_or_with_the_sky():
    depth_m = np.full((120, 160), 5.0, np.float32)
    depth_m[:, 50:] = 9.0
    depth_m[:30] = np.inf

    flat_m, _ = rectify(depth_m, None, BARREL)

    assert set(np.unique(flat_m)) == {5.0, 9.0, np.inf}


def test_maps_refuse_fisheyes():
    fisheye = replace(BARREL, distortion=(), distortion_model="equidistant")
    depth_m = np.ones((120, 160), np.float32)
    for refuses in (
        lambda: rectify_camera(fisheye),
        lambda: rectify(depth_m, None, fisheye),
        lambda: rectify_labels(depth_m.astype(np.uint16), fisheye),
    ):
        with pytest.raises(InvalidInputError, match="equidistant"):
            refuses()


def test_volumes_and_cameras_refuse_distortion():
    depth_m = np.full((120, 160), 5.0, np.float32)
    with pytest.raises(InvalidInputError, match="distortion"):
        TsdfVolume().integrate(depth_m, None, BARREL, np.eye(4))
    with pytest.raises(InvalidInputError, match="distortion"):
        PosedCamera(BARREL, np.eye(4))


def test_images_of_another_size_are_refused():
    with pytest.raises(InvalidInputError, match="depth_m"):
        rectify(np.zeros((4, 5), np.float32), None, BARREL)


def test_an_undistorted_camera_is_not_rectified():
    straight = rectify_camera(BARREL)
    depth_m = plane_depth_m(straight)
    assert rectify_camera(straight) is straight
    assert rectify(depth_m, None, straight)[0] is depth_m
