"""Frames and conversions: the only place where conventions are turned into numbers.

World and body follow REP-103 (x forward, y left, z up; metres, radians). Optical frames have z
forward, x right, y down (REP-103, suffix ``_optical``). ``T_a_b`` maps coordinates in ``b`` to
coordinates in ``a``. Quaternions are (x, y, z, w).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, PinholeIntrinsics, Pose

QUATERNION_TOLERANCE = 1e-3
"""Largest deviation of a quaternion's norm from 1 that is normalised instead of refused."""

R_LINK_OPTICAL: FloatArray = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of ``camera_optical_frame`` in ``camera_link`` (REP-103)."""


def transform(rotation: ArrayLike, translation_m: ArrayLike) -> FloatArray:
    """Return the (4, 4) rigid transform with a (3, 3) rotation and a (3,) translation."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation_m
    return T


T_LINK_OPTICAL: FloatArray = transform(R_LINK_OPTICAL, (0.0, 0.0, 0.0))


def pose_to_matrix(pose: Pose) -> FloatArray:
    """Return ``T_map_body`` (4, 4) of a pose; inverse: `pose_from_matrix`."""
    return transform(Rotation.from_quat(pose.quat_xyzw).as_matrix(), pose.position_m)


def pose_from_matrix(T_map_body: ArrayLike) -> Pose:
    """Return the pose of a (4, 4) rigid transform, with a quaternion whose w is not negative."""
    T = np.asarray(T_map_body, dtype=np.float64)
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    px, py, pz = T[:3, 3]
    return Pose((float(px), float(py), float(pz)), (float(x), float(y), float(z), float(w)))


def invert(T: ArrayLike) -> FloatArray:
    """Return the inverse of a (4, 4) rigid transform."""
    T = np.asarray(T, dtype=np.float64)
    R_inv = T[:3, :3].T
    return transform(R_inv, -R_inv @ T[:3, 3])


def checked_pose(position_m: ArrayLike, quat_xyzw: ArrayLike, field: str = "pose") -> Pose:
    """Return a pose from untrusted numbers, its quaternion normalised.

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
    x, y, z, w = (float(v) for v in quat / norm)
    px, py, pz = (float(v) for v in position)
    return Pose((px, py, pz), (x, y, z, w))


def pose_looking_at(eye_m: ArrayLike, target_m: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Pose:
    """Return the body pose at ``eye_m`` whose x axis points at ``target_m``.

    ``up`` settles the roll; it must not be parallel to the viewing direction.
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
    pitch_down = Rotation.from_euler("y", np.pi / 2)
    rotation = Rotation.from_euler("z", yaw_rad) * pitch_down
    return pose_from_matrix(transform(rotation.as_matrix(), (x_m, y_m, z_m)))


def pixel_rays(intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (H, W, 3) rays through pixel centres in the optical frame, scaled to z = 1.

    A ray times a planar depth is the point it hit.
    """
    u = (np.arange(intrinsics.width_px) - intrinsics.cx_px) / intrinsics.fx_px
    v = (np.arange(intrinsics.height_px) - intrinsics.cy_px) / intrinsics.fy_px
    rays = np.ones((intrinsics.height_px, intrinsics.width_px, 3))
    rays[..., 0] = u[None, :]
    rays[..., 1] = v[:, None]
    return rays


def project(points_camera_m: ArrayLike, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (N, 2) pixels of (N, 3) points in the optical frame; inverse: `unproject`."""
    points = np.asarray(points_camera_m, dtype=np.float64)
    homogeneous = points @ intrinsics.K.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


def unproject(pixels: ArrayLike, depth_m: ArrayLike, intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return (N, 3) points in the optical frame of (N, 2) pixels at (N,) planar depths."""
    uv = np.asarray(pixels, dtype=np.float64)
    z = np.asarray(depth_m, dtype=np.float64)
    x = (uv[:, 0] - intrinsics.cx_px) / intrinsics.fx_px * z
    y = (uv[:, 1] - intrinsics.cy_px) / intrinsics.fy_px * z
    return np.column_stack((x, y, z))


def depth_to_points(
    depth_m: NDArray[np.floating[Any]], intrinsics: PinholeIntrinsics
) -> NDArray[np.float32]:
    """Return (H, W, 3) float32 points in the optical frame of an (H, W) planar depth image.

    Pixels that hit nothing (``+inf``) give non-finite points.
    """
    z = np.asarray(depth_m, dtype=np.float32)
    u = (np.arange(intrinsics.width_px) - intrinsics.cx_px) / intrinsics.fx_px
    v = (np.arange(intrinsics.height_px) - intrinsics.cy_px) / intrinsics.fy_px
    points = np.empty((*z.shape, 3), dtype=np.float32)
    with np.errstate(invalid="ignore"):
        np.multiply(z, u.astype(np.float32)[None, :], out=points[..., 0])
        np.multiply(z, v.astype(np.float32)[:, None], out=points[..., 1])
    points[..., 2] = z
    return points
