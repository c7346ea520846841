"""Conversions of odometry and inertial measurements to ROS messages and back; no node needed."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Twist as TwistMsg
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, ImuInfo, Pose, Twist
from oaisys_ros_bridge.conversions import check_type, pose_from_msg, pose_to_msg

UNKNOWN_VARIANCE = 1e6
"""Variance of an unknown velocity, (m/s)^2 or (rad/s)^2."""

UNKNOWN_ORIENTATION = -1.0
"""First element of the orientation's covariance of an IMU that does not measure it."""


def odometry_to_msg(
    pose: Pose,
    header: Header,
    child_frame: str,
    covariance: ArrayLike | None = None,
    twist: Twist | None = None,
) -> Odometry:
    """Return the odometry of a body; inverses: `odometry_from_msg`, `twist_from_msg`.

    ``geometry_msgs/TwistWithCovariance`` has no value for "unknown", so the variances of an unknown
    twist are `UNKNOWN_VARIANCE`, which gives it no weight in a filter. ``robot_localization`` would
    take a variance of 0 for certainty, and the -1 of ``sensor_msgs/Imu`` for a variance of 1.

    Args:
        pose: In ``header``'s frame.
        header: Stamp and frame.
        child_frame: Of the body.
        covariance: (36,) row-major, of x, y, z and rotations about x, y, z; None: exact.
        twist: In ``child_frame``, exact; None: unknown.
    """
    msg = Odometry(header=header, child_frame_id=child_frame)
    msg.pose.pose = pose_to_msg(pose)
    if twist is None:
        msg.twist.covariance = np.diag(np.full(6, UNKNOWN_VARIANCE)).ravel()
    else:
        linear, angular = _vector(twist.velocity_m_s), _vector(twist.angular_rate_rad_s)
        msg.twist.twist = TwistMsg(linear=linear, angular=angular)
    if covariance is not None:
        msg.pose.covariance = np.asarray(covariance, dtype=np.float64)
    return msg


def odometry_from_msg(msg: Odometry) -> Pose:
    """Return the pose in an odometry message."""
    return pose_from_msg(check_type(msg, Odometry, "odometry").pose.pose, "odometry.pose")


def twist_from_msg(msg: Odometry) -> Twist | None:
    """Return the twist in an odometry message; None if it is unknown.

    Raises:
        TypeError: ``msg`` is not a ``nav_msgs/Odometry``.
        InvalidInputError: A number is not finite.
    """
    check_type(msg, Odometry, "odometry")
    if min(msg.twist.covariance[::7]) >= UNKNOWN_VARIANCE:
        return None
    linear = _finite(msg.twist.twist.linear, "odometry.twist.linear")
    return Twist(linear, _finite(msg.twist.twist.angular, "odometry.twist.angular"))


def imu_to_msg(
    angular_rate_rad_s: ArrayLike, specific_force_m_s2: ArrayLike, imu: ImuInfo, header: Header
) -> Imu:
    """Return the message of one measurement of an IMU; inverse: `imu_from_msg`.

    The orientation is unknown, and its covariance begins with -1, as ``sensor_msgs/Imu`` says. The
    other covariances are those of the white noise; a covariance of 0 means "unknown" there.

    Args:
        angular_rate_rad_s: (3,) angular rate.
        specific_force_m_s2: (3,) acceleration minus gravity.
        imu: The IMU, for its noise.
        header: Stamp, and frame of the IMU.
    """
    msg = Imu(
        header=header,
        angular_velocity=_vector(angular_rate_rad_s),
        linear_acceleration=_vector(specific_force_m_s2),
    )
    msg.orientation_covariance[0] = UNKNOWN_ORIENTATION
    msg.angular_velocity_covariance[::4] = imu.angular_rate_sigma_rad_s**2
    msg.linear_acceleration_covariance[::4] = imu.specific_force_sigma_m_s2**2
    return msg


def imu_from_msg(msg: Imu) -> tuple[FloatArray, FloatArray]:
    """Return the (3,) angular rate and the (3,) specific force in a message.

    Raises:
        TypeError: ``msg`` is not a ``sensor_msgs/Imu``.
        InvalidInputError: A number is not finite.
    """
    check_type(msg, Imu, "imu")
    rate = _finite(msg.angular_velocity, "imu.angular_velocity")
    force = _finite(msg.linear_acceleration, "imu.linear_acceleration")
    return np.array(rate), np.array(force)


def _vector(values: ArrayLike) -> Vector3:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return Vector3(x=x, y=y, z=z)


def _finite(msg: Vector3, field: str) -> tuple[float, float, float]:
    values = (msg.x, msg.y, msg.z)
    if not np.isfinite(values).all():
        raise InvalidInputError(field, values, "finite numbers")
    return values
