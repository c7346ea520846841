"""Stamps of messages as they come from the wire."""

from __future__ import annotations

from typing import Any

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Bool, Header
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from oaisys_core.types import Pose, Twist
from oaisys_msgs.msg import SampleInfo, SemanticLabels
from oaisys_ros_bridge.bags.mcap_format.serialized_stamps import knows_twist, stamp_reader
from oaisys_ros_bridge.motion import odometry_to_msg

HEADER = Header(stamp=Time(sec=7, nanosec=890), frame_id="map")
STAMP_NS = 7_000_000_890


def read(message: Any) -> int:
    read_stamp = stamp_reader(type(message))
    assert read_stamp is not None
    return read_stamp(serialize_message(message))


@pytest.mark.parametrize(
    "kind", [CameraInfo, Image, Odometry, Path, PointCloud2, SampleInfo, SemanticLabels]
)
def test_a_stamp_is_read_from_the_header_in_front(kind: type[Any]) -> None:
    assert read(kind(header=HEADER)) == STAMP_NS


def test_a_stamp_is_read_from_the_first_of_a_sequence() -> None:
    assert read(TFMessage(transforms=[TransformStamped(header=HEADER)] * 2)) == STAMP_NS
    assert read(MarkerArray(markers=[Marker(header=HEADER)])) == STAMP_NS
    assert read(TFMessage()) == 0


def test_odometry_of_samples_knows_no_twist_and_that_of_drives_does() -> None:
    pose = Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    for child in ("base_link", "a", "ab", "abc"):
        of_sample = odometry_to_msg(pose, HEADER, child)
        assert not knows_twist(serialize_message(of_sample))
        of_drive = odometry_to_msg(pose, HEADER, child, twist=Twist((1.0, 0.0, 0.0), (0.0,) * 3))
        assert knows_twist(serialize_message(of_drive))


def test_other_messages_have_none() -> None:
    assert stamp_reader(Bool) is None
    assert stamp_reader(Time) is None
