"""From pixels to rays and points, and back."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.geometry.distortion import MIN_MAGNIFICATION, area_scale, distort, undistort
from oaisys_core.geometry.fisheye import (
    directions_of,
    fisheye_angle_rad,
    fisheye_radius,
    visible_angles_rad,
)
from oaisys_core.types import FloatArray, PinholeIntrinsics

LENS_REACH = 2.0
"""A lens's polynomial holds up to so many times the distance from the axis of the image's corners.

Of a pinhole with distortion it is the distance at z = 1, of a fisheye the angle.
"""

REACH_AZIMUTHS, REACH_RADII = 361, 513
"""Places at which a distortion is searched for folds."""


def is_invertible(intrinsics: PinholeIntrinsics) -> bool:
    """Return whether the distortion can be inverted everywhere in the image, edges included."""
    if intrinsics.is_rectilinear:
        return True
    w, h = intrinsics.width_px, intrinsics.height_px
    columns, rows = np.linspace(-0.5, w - 0.5, 65), np.linspace(-0.5, h - 0.5, 65)
    u, v = (grid.ravel() for grid in np.meshgrid(columns, rows))
    pixels = np.column_stack((u, v))
    return bool(np.isfinite(_directions(pixels, intrinsics)).all())


def pixel_rays(intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (H, W, 3) rays through pixel centres in the optical frame.

    They are scaled to z = 1, those of a fisheye to length 1: a ray times the depth of its pixel is
    the point that it hit. With distortion, the rays are the undistorted directions; the arrays of
    lenses are cached and read-only.
    """
    return _pinhole_rays(intrinsics) if intrinsics.is_rectilinear else _lens_rays(intrinsics)


def depth_along_ray_m(points_camera_m: ArrayLike, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return the (N,) depths that an image has of (N, 3) points: z, of a fisheye the distance."""
    points = np.asarray(points_camera_m, dtype=np.float64)
    return np.asarray(np.linalg.norm(points, axis=-1) if intrinsics.is_fisheye else points[..., 2])


def _pinhole_rays(intrinsics: PinholeIntrinsics) -> FloatArray:
    u = (np.arange(intrinsics.width_px) - intrinsics.cx_px) / intrinsics.fx_px
    v = (np.arange(intrinsics.height_px) - intrinsics.cy_px) / intrinsics.fy_px
    rays = np.ones((intrinsics.height_px, intrinsics.width_px, 3))
    rays[..., 0] = u[None, :]
    rays[..., 1] = v[:, None]
    return rays


@lru_cache(maxsize=4)
def _lens_rays(intrinsics: PinholeIntrinsics) -> FloatArray:
    rays = _pinhole_rays(intrinsics)
    if intrinsics.is_fisheye:
        rays = directions_of(rays[..., :2], intrinsics.distortion)
    else:
        rays[..., :2] = undistort(rays[..., :2], intrinsics.distortion)
    rays.setflags(write=False)
    return rays


def project(points_camera_m: ArrayLike, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (N, 2) pixels of (N, 3) points in the optical frame; inverse: `unproject`.

    They are NaN where a lens's polynomial does not hold: behind a lens that is no fisheye, where
    it folds the image over, and beyond `LENS_REACH`.
    """
    points = np.asarray(points_camera_m, dtype=np.float64)
    if intrinsics.is_rectilinear:
        homogeneous = points @ intrinsics.K.T
        return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])
    image_xy = (_fisheye_image if intrinsics.is_fisheye else _lens_image)(points, intrinsics)
    focal_px = (intrinsics.fx_px, intrinsics.fy_px)
    return np.asarray(image_xy * focal_px + (intrinsics.cx_px, intrinsics.cy_px))


def _lens_image(points_m: FloatArray, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (N, 2) points of the image at z = 1 of (N, 3) points; NaN if there are none."""
    azimuths, reaches = _lens_reach(intrinsics)
    x, y, z = points_m.T
    azimuth = np.arctan2(y, x)
    holds = np.hypot(x, y) <= z * np.interp(azimuth, azimuths, reaches)
    xy = np.full((len(points_m), 2), np.nan)
    np.divide(points_m[:, :2], z[:, None], out=xy, where=(holds & (z > 0))[:, None])
    return distort(xy, intrinsics.distortion)


@lru_cache(maxsize=16)
def _lens_reach(intrinsics: PinholeIntrinsics) -> tuple[FloatArray, FloatArray]:
    """Return azimuths around the axis, and how far from it the distortion holds there, at z = 1."""
    corners = _image_corners(intrinsics)
    straight = undistort(corners, intrinsics.distortion)
    farthest = np.linalg.norm(np.where(np.isfinite(straight), straight, corners), axis=1).max()
    azimuths = np.linspace(-np.pi, np.pi, REACH_AZIMUTHS)
    radii = np.linspace(0.0, LENS_REACH * farthest, REACH_RADII)
    xy = np.stack((np.cos(azimuths), np.sin(azimuths)), axis=-1)[:, None] * radii[:, None]
    scale = area_scale(xy.reshape(-1, 2), intrinsics.distortion)
    surplus = scale.reshape(xy.shape[:2]) - MIN_MAGNIFICATION
    reaches = np.full(len(azimuths), radii[-1])
    folds = np.flatnonzero((surplus <= 0).any(axis=1))
    after = np.maximum((surplus[folds] <= 0).argmax(axis=1), 1)
    high, low = surplus[folds, after - 1], surplus[folds, after]
    reaches[folds] = radii[after - 1] + radii[1] * high / (high - low)
    return azimuths, reaches


def _image_corners(intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return the (4, 2) outer corners of the image, in focal lengths."""
    right, bottom = intrinsics.width_px - 0.5, intrinsics.height_px - 0.5
    pixels = np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)])
    return _normalise(pixels, intrinsics)


def _fisheye_image(points_m: FloatArray, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (N, 2) points of the image, in focal lengths, of (N, 3) points; NaN if none."""
    distortion = intrinsics.distortion
    across_m = np.linalg.norm(points_m[:, :2], axis=1)
    angle = np.arctan2(across_m, points_m[:, 2])
    corners = np.linalg.norm(_image_corners(intrinsics), axis=1)
    farthest = LENS_REACH * fisheye_angle_rad(corners, distortion).max()  # NaN beyond all angles
    angle[(angle > visible_angles_rad(distortion)[-1]) | (angle > farthest)] = np.nan
    radius = fisheye_radius(angle, distortion)
    with np.errstate(invalid="ignore"):
        scale = np.where(across_m > 0, radius / across_m, np.where(angle == 0, 1.0, np.nan))
    return np.asarray(points_m[:, :2] * scale[:, None])


def unproject(pixels: ArrayLike, depth_m: ArrayLike, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (N, 3) points in the optical frame of (N, 2) pixels at (N,) depths of an image."""
    uv = np.asarray(pixels, dtype=np.float64)
    depth = np.asarray(depth_m, dtype=np.float64)
    return np.asarray(_directions(uv, intrinsics) * depth[:, None])


def _directions(pixels: FloatArray, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return the (N, 3) rays of (N, 2) pixels, see `pixel_rays`."""
    xy = _normalise(pixels, intrinsics)
    if intrinsics.is_fisheye:
        return directions_of(xy, intrinsics.distortion)
    return np.column_stack((undistort(xy, intrinsics.distortion), np.ones(len(xy))))


def _normalise(pixels: FloatArray, intrinsics: PinholeIntrinsics) -> FloatArray:
    centre_px = (intrinsics.cx_px, intrinsics.cy_px)
    return np.asarray((pixels - centre_px) / (intrinsics.fx_px, intrinsics.fy_px))


def depth_to_points(
    depth_m: NDArray[np.floating[Any]], intrinsics: PinholeIntrinsics
) -> NDArray[np.float32]:
    """Return (H, W, 3) float32 points in the optical frame of an (H, W) depth image.

    Pixels that hit nothing (``+inf``) give non-finite points.
    """
    z = np.asarray(depth_m, dtype=np.float32)
    points = np.empty((*z.shape, 3), dtype=np.float32)
    with np.errstate(invalid="ignore"):
        if intrinsics.is_fisheye:
            return np.asarray(z[..., None] * _lens_rays(intrinsics).astype(np.float32))
        if any(intrinsics.distortion):
            rays = _lens_rays(intrinsics).astype(np.float32)
            np.multiply(z[..., None], rays[..., :2], out=points[..., :2])
        else:
            u = (np.arange(intrinsics.width_px) - intrinsics.cx_px) / intrinsics.fx_px
            v = (np.arange(intrinsics.height_px) - intrinsics.cy_px) / intrinsics.fy_px
            np.multiply(z, u.astype(np.float32)[None, :], out=points[..., 0])
            np.multiply(z, v.astype(np.float32)[:, None], out=points[..., 1])
    points[..., 2] = z
    return points
