"""What the client of an exploration is told of views that others command."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Time
from ros_peer import Stage
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from oaisys_core.errors import OaisysError
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.experiments.explore.trajectory_client import TrajectoryClient
from oaisys_ros_bridge.qos import SENSOR_QOS, SMALL_MESSAGE_QOS

pytestmark = pytest.mark.ros

IMAGE = {"height": 1, "width": 1, "encoding": "rgb8", "step": 3, "data": b"abc"}


def test_images_that_are_lost_are_told_when_those_of_a_later_view_come(stage: Stage) -> None:
    node = stage.user.node
    images = node.create_publisher(Image, "camera/color/image_raw", SENSOR_QOS)
    infos = node.create_publisher(SampleInfo, "oaisys_bridge/sample_info", SMALL_MESSAGE_QOS)
    headers = [Header(stamp=Time(sec=second)) for second in range(3)]
    with TrajectoryClient("camera", ("rgb",)) as client:
        stage.user.wait_until(
            lambda: images.get_subscription_count() and infos.get_subscription_count()
        )
        for number, header in enumerate(headers):
            infos.publish(SampleInfo(header=header, sequence=number, sample_id=number))
        images.publish(Image(header=headers[2], **IMAGE))
        with pytest.raises(OaisysError, match="images of sample 1 were not received, though"):
            client.wait_for_commanded_view(20.0, lambda: False, 20.0)
