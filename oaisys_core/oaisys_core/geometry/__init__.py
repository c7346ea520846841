"""Coordinate frames, poses and the camera model: all conventions are defined here.

World and body follow REP-103 (x forward, y left, z up; metres, radians). Optical frames have z
forward, x right, y down (REP-103, suffix ``_optical``). ``T_a_b`` maps coordinates in ``b`` to
coordinates in ``a``. Quaternions are (x, y, z, w).
"""

from __future__ import annotations

from oaisys_core.geometry.cameras import (
    LENS_REACH,
    depth_along_ray_m,
    depth_to_points,
    is_invertible,
    pixel_rays,
    project,
    unproject,
)
from oaisys_core.geometry.distortion import (
    INVERSE_TOLERANCE,
    MIN_MAGNIFICATION,
    distort,
    undistort,
)
from oaisys_core.geometry.fisheye import fisheye_angle_rad, fisheye_radius
from oaisys_core.geometry.poses import (
    IDENTITY_QUAT_XYZW,
    MAX_M,
    QUATERNION_TOLERANCE,
    R_LINK_OPTICAL,
    ROTATION_TOLERANCE,
    T_LINK_OPTICAL,
    T_OPTICAL_BLENDER,
    check_pose,
    check_position,
    distances_along_m,
    expect_unit_norm,
    invert,
    is_rigid,
    nadir_spacing_m,
    pose_from_matrix,
    pose_looking_at,
    pose_looking_down,
    pose_to_matrix,
    transform,
    transform_points,
    xyz,
)

__all__ = [
    "IDENTITY_QUAT_XYZW",
    "INVERSE_TOLERANCE",
    "LENS_REACH",
    "MAX_M",
    "MIN_MAGNIFICATION",
    "QUATERNION_TOLERANCE",
    "ROTATION_TOLERANCE",
    "R_LINK_OPTICAL",
    "T_LINK_OPTICAL",
    "T_OPTICAL_BLENDER",
    "check_pose",
    "check_position",
    "depth_along_ray_m",
    "depth_to_points",
    "distances_along_m",
    "distort",
    "expect_unit_norm",
    "fisheye_angle_rad",
    "fisheye_radius",
    "invert",
    "is_invertible",
    "is_rigid",
    "nadir_spacing_m",
    "pixel_rays",
    "pose_from_matrix",
    "pose_looking_at",
    "pose_looking_down",
    "pose_to_matrix",
    "project",
    "transform",
    "transform_points",
    "undistort",
    "unproject",
    "xyz",
]
