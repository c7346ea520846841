"""Messages of odometry and IMUs: what comes back, and what an unknown quantity looks like."""

from __future__ import annotations

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import ImuInfo, Pose, Twist
from oaisys_ros_bridge import motion

HEADER = Header(stamp=Time(sec=7, nanosec=9), frame_id="map")
POSE = Pose((1.0, -2.0, 3.0), (0.5, -0.5, 0.5, 0.5))
TWIST = Twist((0.25, -0.5, 0.125), (-1.0, 2.0, -3.0))
IMU = ImuInfo("imu", np.eye(4), 200.0, angular_rate_sigma_rad_s=0.5, specific_force_sigma_m_s2=0.25)


def test_odometry_comes_back_with_its_twist() -> None:
    msg = motion.odometry_to_msg(POSE, HEADER, "base_link", twist=TWIST)

    there = deserialize_message(serialize_message(msg), Odometry)
    assert (there.header, there.child_frame_id) == (HEADER, "base_link")
    assert motion.odometry_from_msg(there) == POSE
    assert motion.twist_from_msg(there) == TWIST
    assert not np.any(there.twist.covariance)


def test_an_unknown_twist_has_no_weight() -> None:
    msg = motion.odometry_to_msg(POSE, HEADER, "base_link")

    assert motion.twist_from_msg(msg) is None
    assert (np.diag(msg.twist.covariance.reshape(6, 6)) == 1e6).all()


def test_odometry_tells_how_far_it_may_be_off() -> None:
    covariance = np.arange(36.0)

    msg = motion.odometry_to_msg(POSE, HEADER, "base_link", covariance)

    np.testing.assert_array_equal(msg.pose.covariance, covariance)


def test_a_measurement_of_an_imu_comes_back_without_an_orientation() -> None:
    rate, force = (0.1, -0.2, 0.3), (0.0, 0.5, 3.7)

    data = serialize_message(motion.imu_to_msg(rate, force, IMU, HEADER))

    back = motion.imu_from_msg(deserialize_message(data, Imu))
    assert [part.tolist() for part in back] == [list(rate), list(force)]
    # A reader that is not ROS's.
    msg = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, "sensor_msgs/msg/Imu")
    assert msg.orientation_covariance[0] == -1.0
    assert msg.angular_velocity_covariance.tolist() == (np.eye(3) * 0.5**2).ravel().tolist()
    assert msg.linear_acceleration_covariance.tolist() == (np.eye(3) * 0.25**2).ravel().tolist()


def test_numbers_that_are_not_finite_are_refused() -> None:
    odometry = motion.odometry_to_msg(POSE, HEADER, "base_link", twist=TWIST)
    odometry.twist.twist.linear = Vector3(x=np.nan)
    with pytest.raises(InvalidInputError, match=r"odometry\.twist\.linear"):
        motion.twist_from_msg(odometry)
    imu = motion.imu_to_msg((0.0, 0.0, np.inf), (0.0, 0.0, 0.0), IMU, HEADER)
    with pytest.raises(InvalidInputError, match=r"imu\.angular_velocity"):
        motion.imu_from_msg(imu)
    with pytest.raises(TypeError, match="odometry"):
        motion.twist_from_msg(imu)
