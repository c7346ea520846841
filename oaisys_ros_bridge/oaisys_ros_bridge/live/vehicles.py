"""How the camera follows the browser's: freely through the air, or as a rover on the ground."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import (
    R_LINK_OPTICAL,
    T_LINK_OPTICAL,
    pose_looking_at,
    pose_to_matrix,
    transform,
)
from oaisys_core.types import FloatArray

TRACK_M = 0.8
"""Distance of the rover's wheels, between which the slope of the ground is measured."""

MAX_SLOPE_DEG = 35.0
"""Steepest ground that the rover drives on."""

FIRST_EYE_M = np.array((-9.0, -6.0, 3.0))
"""Where a visitor looks from first: east, north, and above the ground."""

INSIDE = 0.9
"""Share of the stage that this place lies in."""

MAX_PITCH_RAD = float(np.radians(80.0))

GroundHeights = Callable[[FloatArray], FloatArray]
"""Return the (N,) heights of the ground under (N, 3) points in ``map``; NaN off the stage."""


class LiveVehicle(Protocol):
    """Carries the camera."""

    def move(
        self, T_map_camera: FloatArray, step_m: FloatArray, R_map_camera: FloatArray
    ) -> FloatArray:
        """Return the next (4, 4) pose of the camera's optical frame in ``map``.

        Args:
            T_map_camera: (4, 4) pose now.
            step_m: (3,) the step that the driver asks for.
            R_map_camera: (3, 3) the orientation that the driver asks for.

        Raises:
            InvalidInputError: The vehicle cannot be there.
        """


class Flight:
    """A camera in the air, which goes wherever the driver asks."""

    def move(
        self, T_map_camera: FloatArray, step_m: FloatArray, R_map_camera: FloatArray
    ) -> FloatArray:
        """See `LiveVehicle`; the simulator refuses poses in the ground."""
        return transform(R_map_camera, T_map_camera[:3, 3] + step_m)


class LiveRover:
    """A camera on a mast: it drives where it looks, and rolls with the ground's slope.

    Args:
        heights_m: Heights of the ground.
        camera_height_m: Of the camera above the ground.
    """

    def __init__(self, heights_m: GroundHeights, camera_height_m: float) -> None:
        self._heights_m = heights_m
        self._camera_height_m = camera_height_m

    def move(
        self, T_map_camera: FloatArray, step_m: FloatArray, R_map_camera: FloatArray
    ) -> FloatArray:
        """See `LiveVehicle`; of the step counts what lies in the rover's heading.

        Raises:
            InvalidInputError: There is no ground, or it is steeper than `MAX_SLOPE_DEG`.
        """
        yaw_rad, pitch_rad = yaw_and_pitch_rad(R_map_camera)
        heading = np.array((np.cos(yaw_rad), np.sin(yaw_rad), 0.0))
        place_m = T_map_camera[:3, 3] + heading * float(heading @ step_m)
        height_m, roll_rad = self._seat(place_m, heading)
        place_m[2] = height_m + self._camera_height_m
        return transform(_optical_rotation(yaw_rad, pitch_rad, roll_rad), place_m)

    def _seat(self, place_m: FloatArray, heading: FloatArray) -> tuple[float, float]:
        """Return the height of the ground at a place, and its slope to the side in radians."""
        left = np.array((-heading[1], heading[0], 0.0))
        offsets = TRACK_M / 2 * np.stack((0 * left, left, -left, heading, -heading))
        heights_m = self._heights_m(place_m + offsets)
        where = [round(float(each), 2) for each in place_m[:2]]
        if not np.isfinite(heights_m).all():
            raise InvalidInputError("rover", where, "a place on the stage, where there is ground")
        middle_m, left_m, right_m, front_m, back_m = (float(each) for each in heights_m)
        slope_deg = np.degrees(np.arctan(np.hypot(left_m - right_m, front_m - back_m) / TRACK_M))
        if slope_deg > MAX_SLOPE_DEG:
            expected = f"ground of at most {MAX_SLOPE_DEG:g} degrees; here it is {slope_deg:.0f}"
            raise InvalidInputError("rover", where, expected)
        return middle_m, float(np.arctan2(left_m - right_m, TRACK_M))


def first_view(
    T_map_camera: FloatArray,
    heights_m: GroundHeights,
    extent_m: tuple[float, float, float, float] | None,
) -> FloatArray:
    """Return the (4, 4) pose that a visitor looks from first.

    It is the rig's start pose, unless that looks straight down, in which one can hardly find one's
    way: then the view is from `FIRST_EYE_M` beside the place below it, or less on a small stage.

    Args:
        T_map_camera: (4, 4) the start pose.
        heights_m: Heights of the ground.
        extent_m: (min_x, min_y, max_x, max_y) of the stage; None if it is not known.
    """
    place_m, forward = T_map_camera[:3, 3], T_map_camera[:3, 2]
    if forward[2] > -np.sin(MAX_PITCH_RAD):
        return T_map_camera
    eye_m = place_m + FIRST_EYE_M
    if extent_m is not None:
        corners_m = np.reshape(extent_m, (2, 2))
        centre_m = corners_m.mean(axis=0)
        eye_m[:2] = np.clip(eye_m[:2], *(centre_m + INSIDE * (corners_m - centre_m)))
    below_m, below_eye_m = (float(each) for each in heights_m(np.stack((place_m, eye_m))))
    if not np.isfinite((below_m, below_eye_m)).all():
        return T_map_camera
    target_m = (place_m[0], place_m[1], below_m)
    eye_m[2] = max(below_eye_m, below_m) + FIRST_EYE_M[2]
    return pose_to_matrix(pose_looking_at(eye_m, target_m)) @ T_LINK_OPTICAL


def yaw_and_pitch_rad(R_map_camera: FloatArray) -> tuple[float, float]:
    """Return where an optical frame looks: yaw from +x to +y, and pitch, positive downwards.

    Looking straight down or up, the yaw is that of the image's upper or lower edge.
    """
    forward, up = R_map_camera[:, 2], -R_map_camera[:, 1]
    level = float(np.hypot(forward[0], forward[1]))
    along = forward if level > 1e-3 else -np.sign(forward[2]) * up
    pitch_rad = float(np.arctan2(-forward[2], level))
    yaw_rad = float(np.arctan2(along[1], along[0]))
    return yaw_rad, float(np.clip(pitch_rad, -MAX_PITCH_RAD, MAX_PITCH_RAD))


def _optical_rotation(yaw_rad: float, pitch_rad: float, roll_rad: float) -> FloatArray:
    from scipy.spatial.transform import Rotation

    body = Rotation.from_euler("ZYX", (yaw_rad, pitch_rad, roll_rad))
    return np.asarray(body.as_matrix() @ R_LINK_OPTICAL)
