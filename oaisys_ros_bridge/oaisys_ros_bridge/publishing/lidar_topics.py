"""The topic of one lidar, and its mount."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from oaisys_core.types import LidarInfo, LidarScan
from oaisys_ros_bridge.clouds import scan_to_msg
from oaisys_ros_bridge.conversions import transform_to_msg
from oaisys_ros_bridge.publishing.publishers import Publishers, has_subscribers
from oaisys_ros_bridge.qos import SENSOR_QOS


class LidarTopics:
    """Publishes the scans of one lidar; without subscribers, no message is made.

    Args:
        publishers: Where the messages go.
        lidar: The lidar.
        namespace: Prefix of its topic.
        frame_prefix: Prefix of its frame's name, before the namespace.
    """

    def __init__(
        self, publishers: Publishers, lidar: LidarInfo, namespace: str, frame_prefix: str
    ) -> None:
        self._publishers = publishers
        self._lidar = lidar
        self._link_frame = f"{frame_prefix}{namespace}_link"
        self._points = publishers.offer(PointCloud2, f"{namespace}/points", SENSOR_QOS)

    def mount(self, base_frame: str, stamp: Time) -> list[TransformStamped]:
        """Return the transform from the rig to the lidar."""
        header = Header(stamp=stamp, frame_id=base_frame)
        return [transform_to_msg(self._lidar.T_base_lidar, header, self._link_frame)]

    def publish(self, scan: LidarScan, stamp: Time) -> None:
        """Publish a scan that began at a stamp."""
        if has_subscribers(self._points):
            header = Header(stamp=stamp, frame_id=self._link_frame)
            self._publishers.send(self._points, scan_to_msg(scan, header))
