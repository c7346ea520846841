"""Which pixels may see boxes, against slabs that each ray is cut with and OpenCV's projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_worlds import camera

from oaisys_core.geometry import invert, pixel_rays, pose_looking_at
from oaisys_core.raycast.objects.visible_boxes import BOX_CORNERS, MAX_BOXES, visible_pixels
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FloatArray, PinholeIntrinsics

PINHOLE = PinholeIntrinsics(
    width_px=64, height_px=48, fx_px=50.0, fy_px=55.0, cx_px=30.0, cy_px=25.0
)


def camera_at(*position_m: float) -> PlacedCamera:
    """A camera that looks at the origin of ``map``."""
    return camera(pose_looking_at(position_m, (0, 0, 0)), PINHOLE)


def seen(camera: PlacedCamera, low_m: FloatArray, high_m: FloatArray) -> NDArray[np.bool_]:
    found = visible_pixels(camera, low_m, high_m)
    assert found is not None
    return found


def meets(seeing: PlacedCamera, low_m: FloatArray, high_m: FloatArray) -> NDArray[np.bool_]:
    """(H, W) whether rays meet a box, by the slabs between its faces."""
    directions = pixel_rays(PINHOLE) @ seeing.T_map_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        ends = (np.stack([low_m, high_m]) - seeing.T_map_camera[:3, 3])[:, None, None] / directions
    enters, leaves = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
    return np.asarray((enters <= leaves) & (leaves > 0))


def test_every_ray_that_meets_a_box_is_among_them() -> None:
    rng = np.random.default_rng(1)
    for _ in range(60):
        seeing = camera_at(*rng.uniform(-12, 12, 2), rng.uniform(0.5, 12))
        low_m = rng.uniform((-15, -15, -1.5), (15, 15, 1.5), (40, 3))
        high_m = low_m + rng.uniform(0.05, 2, (40, 3))
        expected = np.any([meets(seeing, *box) for box in zip(low_m, high_m, strict=True)], axis=0)
        found = seen(seeing, low_m, high_m)
        assert found.shape == expected.shape
        assert found[expected].all()


def test_a_box_ahead_takes_the_rectangle_around_its_corners() -> None:
    rng = np.random.default_rng(2)
    K = np.array([[PINHOLE.fx_px, 0, PINHOLE.cx_px], [0, PINHOLE.fy_px, PINHOLE.cy_px], [0, 0, 1]])
    for _ in range(20):
        seeing = camera_at(*rng.uniform(-12, 12, 2), rng.uniform(4, 12))
        low_m = rng.uniform(-1, 1, 3)
        high_m = low_m + rng.uniform(0.1, 1, 3)
        T_camera_map = invert(seeing.T_map_camera)
        corners = low_m + BOX_CORNERS * (high_m - low_m)
        pixels, _ = cv2.projectPoints(
            corners, cv2.Rodrigues(T_camera_map[:3, :3])[0], T_camera_map[:3, 3], K, None
        )
        u, v = pixels[:, 0].T
        columns, rows = np.meshgrid(np.arange(PINHOLE.width_px), np.arange(PINHOLE.height_px))
        inside = (u.min() <= columns) & (columns <= u.max()) & (v.min() <= rows) & (rows <= v.max())
        np.testing.assert_array_equal(seen(seeing, low_m[None], high_m[None]), inside)


def test_a_box_around_the_camera_is_seen_by_all_pixels() -> None:
    assert seen(camera_at(3, 4, 5), np.full((1, 3), -20.0), np.full((1, 3), 20.0)).all()


@pytest.mark.parametrize("middle_m", [(6.0, 8.0, 10.0), (-24.0, 18.0, 5.0), (24.0, -18.0, 5.0)])
def test_boxes_behind_and_beside_are_seen_by_none(middle_m: tuple[float, float, float]) -> None:
    middle = np.array([middle_m], np.float64)
    assert not seen(camera_at(3, 4, 5), middle - 0.5, middle + 0.5).any()


def test_no_box_is_seen_by_none() -> None:
    assert not seen(camera_at(3, 4, 5), np.empty((0, 3)), np.empty((0, 3))).any()


def test_too_many_boxes_are_anywhere() -> None:
    seeing = camera_at(3, 4, 5)
    low_m = np.full((MAX_BOXES, 3), -0.5, np.float64)
    assert 0 < seen(seeing, low_m, -low_m).mean() < 1
    more_m = np.full((MAX_BOXES + 1, 3), -0.5, np.float64)
    assert visible_pixels(seeing, more_m, more_m + 1) is None
