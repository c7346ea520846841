"""The topic of one IMU, and its mount."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from numpy.typing import ArrayLike
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from oaisys_core.types import ImuInfo
from oaisys_ros_bridge.conversions import transform_to_msg
from oaisys_ros_bridge.motion import imu_to_msg
from oaisys_ros_bridge.publishing.publishers import Publishers, has_subscribers
from oaisys_ros_bridge.qos import MOTION_QOS


class ImuTopics:
    """Publishes the measurements of one IMU; without subscribers, no message is made.

    Args:
        publishers: Where the messages go.
        imu: The IMU.
        namespace: Prefix of its topic.
        frame_prefix: Prefix of its frame's name, before the namespace.
    """

    def __init__(
        self, publishers: Publishers, imu: ImuInfo, namespace: str, frame_prefix: str
    ) -> None:
        self._publishers = publishers
        self._imu = imu
        self._link_frame = f"{frame_prefix}{namespace}_link"
        self._data = publishers.offer(Imu, f"{namespace}/data_raw", MOTION_QOS)

    def mount(self, base_frame: str, stamp: Time) -> list[TransformStamped]:
        """Return the transform from the rig to the IMU."""
        header = Header(stamp=stamp, frame_id=base_frame)
        return [transform_to_msg(self._imu.T_base_imu, header, self._link_frame)]

    def publish(
        self, angular_rate_rad_s: ArrayLike, specific_force_m_s2: ArrayLike, stamp: Time
    ) -> None:
        """Publish one measurement: (3,) angular rate and (3,) specific force."""
        if has_subscribers(self._data):
            header = Header(stamp=stamp, frame_id=self._link_frame)
            message = imu_to_msg(angular_rate_rad_s, specific_force_m_s2, self._imu, header)
            self._publishers.send(self._data, message)
