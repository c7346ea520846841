"""Rectification: images of a lens with distortion, resampled for a pinhole camera.

Integration and visibility assume pinhole cameras and refuse distortion.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pixel_rays, project, undistort
from oaisys_core.types import PLUMB_BOB, FloatArray, PinholeIntrinsics

SAME_SURFACE = 0.05
"""Largest relative difference of neighbouring depths between which depth is interpolated."""

BORDER_POINTS = 256
"""Points on each edge of an image that determine its field of view."""


def rectify_camera(camera: PinholeIntrinsics) -> PinholeIntrinsics:
    """Return the pinhole camera of the same size whose field of view lies within ``camera``'s.

    Its image is the largest upright rectangle between the curved edges.

    Raises:
        InvalidInputError: It is a fisheye, which may see more than any pinhole camera.
    """
    if camera.is_fisheye:
        received = camera.distortion_model
        raise InvalidInputError("camera.distortion_model", received, f"{PLUMB_BOB}: a pinhole")
    if not any(camera.distortion):
        return camera
    right, bottom = camera.width_px - 1, camera.height_px - 1
    u, v = np.linspace(0, right, BORDER_POINTS), np.linspace(0, bottom, BORDER_POINTS)
    x0 = _undistort_pixels(camera, np.zeros_like(v), v)[:, 0].max()
    x1 = _undistort_pixels(camera, np.full_like(v, right), v)[:, 0].min()
    y0 = _undistort_pixels(camera, u, np.zeros_like(u))[:, 1].max()
    y1 = _undistort_pixels(camera, u, np.full_like(u, bottom))[:, 1].min()
    fx, fy = float(right / (x1 - x0)), float(bottom / (y1 - y0))
    return PinholeIntrinsics(
        camera.width_px, camera.height_px, fx, fy, float(-x0 * fx), float(-y0 * fy)
    )


def rectify(
    depth_m: NDArray[np.float32], rgb: NDArray[np.uint8] | None, camera: PinholeIntrinsics
) -> tuple[NDArray[np.float32], NDArray[np.uint8] | None]:
    """Return the images of `rectify_camera`: (H, W) depth and (H, W, 3) colour.

    Inverse depth, which is linear on a plane, is interpolated within one surface; where neighbours
    differ by more than `SAME_SURFACE` or are not finite, the nearest pixel is used.

    Raises:
        InvalidInputError: The images' sizes do not fit a camera with distortion.
    """
    if camera.is_rectilinear:
        return depth_m, rgb
    size = (camera.height_px, camera.width_px)
    for name, image in (("depth_m", depth_m), ("rgb", rgb)):
        if image is not None and image.shape[:2] != size:
            raise InvalidInputError(name, image.shape, f"an image of shape {size}")
    v_u = _source_positions(camera)
    with np.errstate(divide="ignore"):
        inverse = 1 / depth_m.astype(np.float64)
    least, most = _neighbour_extremes(inverse, v_u)
    smooth = scipy.ndimage.map_coordinates(inverse, v_u, order=1, mode="nearest")
    nearest = scipy.ndimage.map_coordinates(inverse, v_u, order=0, mode="nearest")
    is_same_surface = (least > 0) & (most <= least * (1 + SAME_SURFACE))
    with np.errstate(divide="ignore"):
        rectified_m = (1 / np.where(is_same_surface, smooth, nearest)).astype(np.float32)
    if rgb is None:
        return rectified_m, None
    channels = [
        scipy.ndimage.map_coordinates(rgb[..., i].astype(np.float32), v_u, order=1, mode="nearest")
        for i in range(3)
    ]
    return rectified_m, np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


def rectify_labels(labels: NDArray[np.uint16], camera: PinholeIntrinsics) -> NDArray[np.uint16]:
    """Return the (H, W) labels of `rectify_camera`, each from the nearest pixel.

    Raises:
        InvalidInputError: The image's size does not fit a camera with distortion.
    """
    if camera.is_rectilinear:
        return labels
    size = (camera.height_px, camera.width_px)
    if labels.shape != size:
        raise InvalidInputError("labels", labels.shape, f"an image of shape {size}")
    v_u = _source_positions(camera)
    found = scipy.ndimage.map_coordinates(labels, v_u, order=0, mode="nearest")
    return np.asarray(found, np.uint16)


def _source_positions(camera: PinholeIntrinsics) -> FloatArray:
    """Return (2, H, W) positions (v, u) of the rectified pixels in the original image."""
    rays = pixel_rays(rectify_camera(camera)).reshape(-1, 3)
    v_u = project(rays, camera)[:, ::-1].T
    return np.asarray(v_u.reshape(2, camera.height_px, camera.width_px))


def _undistort_pixels(camera: PinholeIntrinsics, u: FloatArray, v: FloatArray) -> FloatArray:
    pixels = np.column_stack(((u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px))
    return undistort(pixels, camera.distortion)


def _neighbour_extremes(image: FloatArray, v_u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the minimum and maximum of the four pixels around each of (2, H, W) positions."""
    rows, columns = image.shape
    v = np.clip(np.floor(v_u[0]).astype(np.intp), 0, rows - 1)
    u = np.clip(np.floor(v_u[1]).astype(np.intp), 0, columns - 1)
    below, beside = np.minimum(v + 1, rows - 1), np.minimum(u + 1, columns - 1)
    four = np.stack((image[v, u], image[v, beside], image[below, u], image[below, beside]))
    return four.min(axis=0), four.max(axis=0)
