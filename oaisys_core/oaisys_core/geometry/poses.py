"""Poses and rigid transforms, and the frames of links, cameras and Blender."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, PinholeIntrinsics, Pose

QUATERNION_TOLERANCE = 1e-2
"""Quaternions whose norm differs from 1 by at most this are normalised, others are refused.

Two digits typed by hand are accepted, as tf2 accepts them.
"""

NORMALISED_TOLERANCE = 1e-12
"""Quaternions whose norm differs from 1 by at most this count as normalised.

Division by the norm leaves less than 1e-15, products of some rotations as SciPy makes them little
more.
"""

ROTATION_TOLERANCE = 1e-6
"""Largest error of an entry of a rotation matrix times its transpose, see `is_rigid`."""

MAX_M = 1e7
"""Largest coordinate or size, up to which float32 is precise enough."""

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


def expect_unit_norm(norm: float) -> str:
    """Return what was expected instead of a quaternion's norm; empty: nothing, it is about 1."""
    if abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        return ""
    return f"a unit quaternion (norm within {QUATERNION_TOLERANCE} of 1, not {norm:.6g})"


def has_mask(values: object) -> bool:
    """Return whether an array masks a value, which `numpy.asarray` would take for a number."""
    return isinstance(values, np.ma.MaskedArray) and bool(np.any(values.mask))


def check_position(position_m: ArrayLike, field: str) -> FloatArray:
    """Return (3,) untrusted coordinates in metres as an array.

    Raises:
        InvalidInputError: There are not three, or one is no number, or beyond `MAX_M`: with those
            within, squares and cubes are finite.
    """
    expected = f"three finite metres from {-MAX_M:g} to {MAX_M:g}"
    try:
        position = np.asarray(position_m, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(field, position_m, expected) from error
    is_position = position.shape == (3,) and not has_mask(position_m)
    if not (is_position and (np.abs(position) <= MAX_M).all()):
        raise InvalidInputError(field, position.tolist(), expected)
    return position


def check_pose(position_m: ArrayLike, quat_xyzw: ArrayLike, field: str = "pose") -> Pose:
    """Return a pose from untrusted numbers, its quaternion normalised.

    A quaternion that is normalised stays as it is: dividing it by its norm again may change its
    last digits, and a recorded pose would not repeat.

    Raises:
        InvalidInputError: A number is not finite, a coordinate is beyond `MAX_M`, or the
            quaternion's norm is off 1 by more than `QUATERNION_TOLERANCE`.
    """
    position = check_position(position_m, f"{field}.position")
    try:
        quat = np.asarray(quat_xyzw, dtype=np.float64)
    except (TypeError, ValueError) as error:
        expected = "four finite numbers"
        raise InvalidInputError(f"{field}.orientation", quat_xyzw, expected) from error
    is_quaternion = quat.shape == (4,) and not has_mask(quat_xyzw)
    if not (is_quaternion and np.isfinite(quat).all()):
        raise InvalidInputError(f"{field}.orientation", quat.tolist(), "four finite numbers")
    norm = float(np.linalg.norm(quat))
    if expected := expect_unit_norm(norm):
        raise InvalidInputError(f"{field}.orientation", quat.tolist(), expected)
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

    Raises:
        InvalidInputError: A point is none, see `check_position`, or the target is on the up axis.
    """
    eye = check_position(eye_m, "eye_m")
    x = check_position(target_m, "target_m") - eye
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
