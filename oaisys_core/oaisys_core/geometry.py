"""Coordinate frames, poses and the camera model: all conventions are defined here.

World and body follow REP-103 (x forward, y left, z up; metres, radians). Optical frames have z
forward, x right, y down (REP-103, suffix ``_optical``). ``T_a_b`` maps coordinates in ``b`` to
coordinates in ``a``. Quaternions are (x, y, z, w).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, PinholeIntrinsics, Pose

QUATERNION_TOLERANCE = 1e-3
"""Quaternions whose norm differs from 1 by at most this are normalised, others are refused."""

NORMALISED_TOLERANCE = 1e-12
"""Quaternions whose norm differs from 1 by at most this count as normalised.

Division by the norm leaves less than 1e-15, products of some rotations as SciPy makes them little
more.
"""

INVERSE_TOLERANCE = 1e-12
ROTATION_TOLERANCE = 1e-6
"""Largest error, at z = 1, of the inverse of the distortion."""

INVERSE_STEPS = 8
NEWTON_STEPS, FOLD_STEPS = 6, 18
"""Steps from the centre of the lens to a pixel, Newton steps at the pixel, and most further ones
beside a fold, where each of them only halves the error."""

INVERSE_CHUNK = 16384
"""Pixels that are processed at once, so that intermediate arrays fit into the CPU cache."""

INVERSE_HALVINGS = 10
"""How often a step of Newton's method that leads beyond a fold is halved."""

LEAST_MAGNIFICATION = 1e-3
"""A distortion that scales areas by less than this anywhere in the image is refused.

The same holds for the slope of a fisheye's radius over the angle.
"""

FISHEYE_ANGLES = 4097
"""Angles up to 180 degrees at which a fisheye's radius is tabulated, for its inverse."""

LENS_REACH = 2.0
"""A lens's polynomial holds up to so many times the distance from the axis of the image's corners.

Of a pinhole with distortion it is the distance at z = 1, of a fisheye the angle.
"""

REACH_AZIMUTHS, REACH_RADII = 361, 513
"""Places at which a distortion is searched for folds."""

IDENTITY_QUAT_XYZW = (0.0, 0.0, 0.0, 1.0)

R_LINK_OPTICAL: FloatArray = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of ``camera_optical_frame`` in ``camera_link`` (REP-103)."""


def transform(rotation: ArrayLike, translation_m: ArrayLike) -> FloatArray:
    """Return the (4, 4) rigid transform with a (3, 3) rotation and a (3,) translation."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation_m
    return T


T_LINK_OPTICAL: FloatArray = transform(R_LINK_OPTICAL, (0.0, 0.0, 0.0))

T_OPTICAL_BLENDER: FloatArray = transform(np.diag((1.0, -1.0, -1.0)), (0.0, 0.0, 0.0))
"""Blender's camera looks along -z with y up; an optical frame along z with y down."""


def pose_to_matrix(pose: Pose) -> FloatArray:
    """Return ``T_map_body`` (4, 4) of a pose; inverse: `pose_from_matrix`."""
    if pose.quat_xyzw == IDENTITY_QUAT_XYZW:  # most mounts; SciPy takes long to import
        return transform(np.eye(3), pose.position_m)
    from scipy.spatial.transform import Rotation

    return transform(Rotation.from_quat(pose.quat_xyzw).as_matrix(), pose.position_m)


def pose_from_matrix(T_map_body: ArrayLike) -> Pose:
    """Return the pose of a (4, 4) rigid transform, with a quaternion whose w is not negative."""
    from scipy.spatial.transform import Rotation

    T = np.asarray(T_map_body, dtype=np.float64)
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    px, py, pz = T[:3, 3]
    return Pose((float(px), float(py), float(pz)), (float(x), float(y), float(z), float(w)))


def xyz(values: FloatArray) -> tuple[float, float, float]:
    """Return a (3,) array as a tuple."""
    x, y, z = values.tolist()
    return (x, y, z)


def invert(T: ArrayLike) -> FloatArray:
    """Return the inverse of a (4, 4) rigid transform."""
    T = np.asarray(T, dtype=np.float64)
    R_inv = T[:3, :3].T
    return transform(R_inv, -R_inv @ T[:3, 3])


def transform_points(T_a_b: FloatArray, points_b_m: NDArray[np.floating[Any]]) -> FloatArray:
    """Return (..., 3) points in the frame a of points in the frame b."""
    return np.asarray(points_b_m @ T_a_b[:3, :3].T + T_a_b[:3, 3])


def distances_along_m(places_m: ArrayLike) -> FloatArray:
    """Return the (N,) distances along a line of (N, D) places from its first."""
    steps_m = np.linalg.norm(np.diff(np.asarray(places_m, np.float64), axis=0), axis=1)
    return np.append(0.0, np.cumsum(steps_m))


def checked_pose(position_m: ArrayLike, quat_xyzw: ArrayLike, field: str = "pose") -> Pose:
    """Return a pose from untrusted numbers, its quaternion normalised.

    A quaternion that is normalised stays as it is: dividing it by its norm again may change its
    last digits, and a recorded pose would not repeat.

    Raises:
        InvalidInputError: A number is not finite, or the quaternion's norm is off 1 by more than
            `QUATERNION_TOLERANCE`.
    """
    position = np.asarray(position_m, dtype=np.float64)
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise InvalidInputError(f"{field}.position", position.tolist(), "three finite metres")
    if quat.shape != (4,) or not np.isfinite(quat).all():
        raise InvalidInputError(f"{field}.orientation", quat.tolist(), "four finite numbers")
    norm = float(np.linalg.norm(quat))
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise InvalidInputError(
            f"{field}.orientation",
            quat.tolist(),
            f"a unit quaternion (norm within {QUATERNION_TOLERANCE} of 1, not {norm:.6g})",
        )
    if abs(norm - 1.0) > NORMALISED_TOLERANCE:
        quat = quat / norm
    x, y, z, w = (float(v) for v in quat)
    px, py, pz = (float(v) for v in position)
    return Pose((px, py, pz), (x, y, z, w))


def is_rigid(T: FloatArray) -> bool:
    """Return whether a (4, 4) matrix is a rotation, within `ROTATION_TOLERANCE`, and a shift."""
    if T.shape != (4, 4) or not np.isfinite(T).all() or not np.allclose(T[3], (0, 0, 0, 1)):
        return False
    R = T[:3, :3]
    is_orthonormal = np.allclose(R @ R.T, np.eye(3), atol=ROTATION_TOLERANCE)
    return bool(is_orthonormal and np.linalg.det(R) > 0)


def pose_looking_at(eye_m: ArrayLike, target_m: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Pose:
    """Return the body pose at ``eye_m`` whose x axis points at ``target_m``.

    ``up`` defines the roll; it must not be parallel to the viewing direction.
    """
    eye = np.asarray(eye_m, dtype=np.float64)
    x = np.asarray(target_m, dtype=np.float64) - eye
    y = np.cross(np.asarray(up, dtype=np.float64), x)
    if np.linalg.norm(x) < 1e-9 or np.linalg.norm(y) < 1e-9 * np.linalg.norm(x):
        raise InvalidInputError("target_m", list(map(float, x + eye)), "a target off the up axis")
    x = x / np.linalg.norm(x)
    y = y / np.linalg.norm(y)
    return pose_from_matrix(transform(np.column_stack((x, y, np.cross(x, y))), eye))


def pose_looking_down(x_m: float, y_m: float, z_m: float, yaw_rad: float = 0.0) -> Pose:
    """Return the body pose whose x axis points straight down (nadir).

    At yaw 0 the image's upper edge points along ``map``'s +x.
    """
    from scipy.spatial.transform import Rotation

    pitch_down = Rotation.from_euler("y", np.pi / 2)
    rotation = Rotation.from_euler("z", yaw_rad) * pitch_down
    return pose_from_matrix(transform(rotation.as_matrix(), (x_m, y_m, z_m)))


def nadir_spacing_m(
    altitude_m: float, overlap: float, intrinsics: PinholeIntrinsics
) -> tuple[float, float]:
    """Return the distance in x and y between overlapping nadir views of flat ground.

    Image rows lie along x. ``overlap`` is the share of an image's edge that neighbouring views have
    in common. Distortion is ignored.
    """
    step_x_m = altitude_m * intrinsics.width_px / intrinsics.fx_px * (1 - overlap)
    step_y_m = altitude_m * intrinsics.height_px / intrinsics.fy_px * (1 - overlap)
    return step_x_m, step_y_m


def distorted(xy: ArrayLike, distortion: tuple[float, ...]) -> FloatArray:
    """Return (..., 2) distorted coordinates at z = 1 of (..., 2) undistorted ones (Brown-Conrady).

    Inverse: `undistorted`. ``distortion`` is (k1, k2, p1, p2, k3), or empty for none.
    """
    xy = np.asarray(xy, dtype=np.float64)
    if not any(distortion):
        return xy
    x, y = xy[..., 0], xy[..., 1]
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    distorted_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack((distorted_x, distorted_y), axis=-1)


def undistorted(xy: ArrayLike, distortion: tuple[float, ...]) -> FloatArray:
    """Return (..., 2) undistorted coordinates at z = 1 of (..., 2) distorted ones; NaN if none.

    Newton's method starts at the centre of the lens and approaches the pixel in small steps, so
    that it does not jump to another root. The result is exact to `INVERSE_TOLERANCE`.
    """
    xy = np.asarray(xy, dtype=np.float64)
    if not any(distortion):
        return xy
    targets = xy.reshape(-1, 2)
    found = np.empty_like(targets)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for begin in range(0, len(targets), INVERSE_CHUNK):
            chunk = slice(begin, begin + INVERSE_CHUNK)
            found[chunk] = _undistorted_chunk(targets[chunk], distortion)
    return found.reshape(xy.shape)


def _undistorted_chunk(target: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    found = np.zeros_like(target)
    steps = [(step + 1) / INVERSE_STEPS for step in range(INVERSE_STEPS)]
    for share in [share for share in steps for _ in range(2)] + [1.0] * NEWTON_STEPS:
        found = _newton_step(found, share * target, distortion)
    for _ in range(FOLD_STEPS):
        error = np.abs(distorted(found, distortion) - target).max(axis=1)
        far = np.flatnonzero(~(error < INVERSE_TOLERANCE))
        if not len(far):
            break
        found[far] = _newton_step(found[far], target[far], distortion)
    error = np.abs(distorted(found, distortion) - target).max(axis=1)
    is_valid = (_area_scale(found, distortion) > LEAST_MAGNIFICATION) & (error < INVERSE_TOLERANCE)
    found[~is_valid] = np.nan
    return found


def _newton_step(
    found: FloatArray, target: FloatArray, distortion: tuple[float, ...]
) -> FloatArray:
    """Return undistorted points nearer to (N, 2) distorted ones, on this side of a fold."""
    a, b, d = _magnification(found, distortion)
    u, v = (distorted(found, distortion) - target).T
    step = np.column_stack((d * u - b * v, a * v - b * u)) / (a * d - b * b)[:, None]
    for _ in range(INVERSE_HALVINGS):
        folded = ~(_area_scale(found - step, distortion) > LEAST_MAGNIFICATION)
        if not folded.any():
            break
        step[folded] /= 2
    return np.asarray(found - step)


def _area_scale(xy: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Return the (N,) factors by which `distorted` scales areas; not above 0 beyond a fold."""
    a, b, d = _magnification(xy, distortion)
    return a * d - b * b


def _magnification(
    xy: FloatArray, distortion: tuple[float, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the (N,) entries xx, xy = yx and yy of the derivative of `distorted`."""
    x, y = xy[:, 0], xy[:, 1]
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    xx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    yy = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    return xx, x * y * slope + 2 * p1 * x + 2 * p2 * y, yy


def fisheye_radius(angle_rad: ArrayLike, distortion: tuple[float, ...]) -> FloatArray:
    """Return the radii, in focal lengths, at which a fisheye images directions off its axis.

    The model is OpenCV's ``fisheye`` (J. Kannala and S. Brandt, "A generic camera model and
    calibration method for conventional, wide-angle, and fish-eye lenses", PAMI 28, 2006):
    angle * (1 + k1 angle^2 + k2 angle^4 + k3 angle^6 + k4 angle^8). Inverse: `fisheye_angle_rad`.
    """
    angle = np.asarray(angle_rad, dtype=np.float64)
    k1, k2, k3, k4 = distortion or (0.0,) * 4
    square = angle * angle
    factor = 1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))
    return np.asarray(angle * factor)


def _fisheye_slope(angle_rad: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Return the derivative of `fisheye_radius`."""
    k1, k2, k3, k4 = distortion or (0.0,) * 4
    square = angle_rad * angle_rad
    slope = 1 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4)))
    return np.asarray(slope)


def fisheye_angle_rad(radius: ArrayLike, distortion: tuple[float, ...]) -> FloatArray:
    """Return the angles off the axis of radii in focal lengths; NaN where a lens sees nothing.

    A lens sees up to 180 degrees, or up to where its radius stops growing with the angle.
    """
    radius = np.asarray(radius, dtype=np.float64)
    angles = _fisheye_angles(distortion)
    radii = fisheye_radius(angles, distortion)
    angle = np.interp(radius, radii, angles, right=np.nan)
    # The table's error squares with each of Newton's steps.
    for _ in range(2):
        error = fisheye_radius(angle, distortion) - radius
        angle = angle - error / _fisheye_slope(angle, distortion)
    return np.asarray(angle)


def _fisheye_angles(distortion: tuple[float, ...]) -> FloatArray:
    """Return the angles of the table, up to where a lens's radius stops growing."""
    angles = np.linspace(0.0, np.pi, FISHEYE_ANGLES)
    folds = np.flatnonzero(_fisheye_slope(angles, distortion) < LEAST_MAGNIFICATION)
    return angles[: folds[0]] if len(folds) else angles


def _fisheye_directions(xy: FloatArray, distortion: tuple[float, ...]) -> FloatArray:
    """Return (..., 3) unit vectors of (..., 2) points of the image in focal lengths."""
    radius = np.linalg.norm(xy, axis=-1)
    angle = fisheye_angle_rad(radius, distortion)
    with np.errstate(invalid="ignore"):
        across = np.where(radius > 0, np.sin(angle) / radius, 1.0)
    return np.concatenate((xy * across[..., None], np.cos(angle)[..., None]), axis=-1)


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
        rays = _fisheye_directions(rays[..., :2], intrinsics.distortion)
    else:
        rays[..., :2] = undistorted(rays[..., :2], intrinsics.distortion)
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
    return distorted(xy, intrinsics.distortion)


@lru_cache(maxsize=16)
def _lens_reach(intrinsics: PinholeIntrinsics) -> tuple[FloatArray, FloatArray]:
    """Return azimuths around the axis, and how far from it the distortion holds there, at z = 1."""
    corners = _image_corners(intrinsics)
    straight = undistorted(corners, intrinsics.distortion)
    farthest = np.linalg.norm(np.where(np.isfinite(straight), straight, corners), axis=1).max()
    azimuths = np.linspace(-np.pi, np.pi, REACH_AZIMUTHS)
    radii = np.linspace(0.0, LENS_REACH * farthest, REACH_RADII)
    xy = np.stack((np.cos(azimuths), np.sin(azimuths)), axis=-1)[:, None] * radii[:, None]
    scale = _area_scale(xy.reshape(-1, 2), intrinsics.distortion)
    surplus = scale.reshape(xy.shape[:2]) - LEAST_MAGNIFICATION
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
    return _normalised(pixels, intrinsics)


def _fisheye_image(points_m: FloatArray, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (N, 2) points of the image, in focal lengths, of (N, 3) points; NaN if none."""
    distortion = intrinsics.distortion
    across_m = np.linalg.norm(points_m[:, :2], axis=1)
    angle = np.arctan2(across_m, points_m[:, 2])
    corners = np.linalg.norm(_image_corners(intrinsics), axis=1)
    farthest = LENS_REACH * fisheye_angle_rad(corners, distortion).max()  # NaN beyond all angles
    angle[(angle > _fisheye_angles(distortion)[-1]) | (angle > farthest)] = np.nan
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
    xy = _normalised(pixels, intrinsics)
    if intrinsics.is_fisheye:
        return _fisheye_directions(xy, intrinsics.distortion)
    return np.column_stack((undistorted(xy, intrinsics.distortion), np.ones(len(xy))))


def _normalised(pixels: FloatArray, intrinsics: PinholeIntrinsics) -> FloatArray:
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
