"""Conversion from Blender's axes, which original files use, to ours."""

from __future__ import annotations

from math import hypot

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core.geometry import pose_from_matrix, pose_to_matrix, transform
from oaisys_core.types import FloatArray, Pose

LINK_FROM_CAMERA: FloatArray = np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]])
"""Blender's camera looks along -z with y up; a link's x points forward, its z up."""

BODY_FROM_TRACKING: FloatArray = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""The base of ``centeredTarget``: its z axis points to the target, y is up."""


def blender_rotation(quat_wxyz: ArrayLike) -> FloatArray:
    """Return the (3, 3) rotation of a quaternion; Blender treats zeros as a half turn about x."""
    w, x, y, z = (float(v) for v in np.asarray(quat_wxyz, dtype=np.float64))
    if w == x == y == z == 0:
        x = 1.0
    norm = hypot(w, x, y, z)
    pose = Pose((0.0, 0.0, 0.0), (x / norm, y / norm, z / norm, w / norm))
    return pose_to_matrix(pose)[:3, :3]


def mount(transformation: ArrayLike, body_from_base: FloatArray = LINK_FROM_CAMERA) -> Pose:
    """Return the pose of a camera's link on the rig.

    Args:
        transformation: (x, y, z, qw, qx, qy, qz) of Blender's camera in the original's base.
        body_from_base: (3, 3) from the original's base to ``base_link``.
    """
    numbers = np.asarray(transformation, dtype=np.float64)
    rotation = body_from_base @ blender_rotation(numbers[3:]) @ LINK_FROM_CAMERA.T
    return pose_from_matrix(transform(rotation, body_from_base @ numbers[:3]))


def rig_pose(row: ArrayLike) -> Pose:
    """Return the rig pose of a row (x, y, z, qw, qx, qy, qz) of an original pose file."""
    numbers = np.asarray(row, dtype=np.float64)
    return pose_from_matrix(
        transform(blender_rotation(numbers[3:]) @ LINK_FROM_CAMERA.T, numbers[:3])
    )
