"""What the bridge publishes while colour is still being rendered, and what becomes of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from ros_peer import Stage, nanoseconds, stamped
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from served_simulator import FLAT_WORLD
from tf2_msgs.msg import TFMessage
from waiting import PATIENCE_S

from oaisys_core.geometry import pose_looking_down
from oaisys_msgs.msg import SampleInfo
from oaisys_msgs.srv import SetPose, StepBatch
from oaisys_ros_bridge.clouds import cloud_from_msg
from oaisys_ros_bridge.conversions import image_from_msg
from oaisys_ros_bridge.qos import SENSOR_QOS, TF_QOS

pytestmark = pytest.mark.ros

EARLY: dict[str, type[Any]] = {
    "camera/depth/image_raw": Image,
    "camera/depth/camera_info": CameraInfo,
    "camera/semantic_0/image_raw": Image,
    "camera/instance/image_raw": Image,
    "ground_truth/odometry": Odometry,
}
LATE: dict[str, type[Any]] = {
    "camera/color/image_raw": Image,
    "camera/color/camera_info": CameraInfo,
    "camera/depth_registered/points": PointCloud2,
    "oaisys_bridge/sample_info": SampleInfo,
}


SLOW_FROM_SAMPLE_3 = {"OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": f"late-slow:{2 * PATIENCE_S:g}@3"}
"""The third sample takes longer than any test once its depth is there."""


def test_depth_goes_out_before_colour_for_which_a_cloud_waits_and_no_failed_sample_is_complete(
    stage: Stage,
) -> None:
    user = stage.user
    for topic, kind in (EARLY | LATE).items():
        user.listen(kind, topic, SENSOR_QOS)
    user.listen(TFMessage, "/tf", TF_QOS)
    stage.start_bridge(stage.start_world(FLAT_WORLD, **SLOW_FROM_SAMPLE_3).address)
    user.wait_until_ready()
    plain = user.set_pose(pose_looking_down(0, 0, 5), modalities=["depth"])
    colored = user.set_pose(pose_looking_down(0, 0, 6))
    assert plain.success
    assert colored.success
    received = user.received
    user.wait_until(lambda: len(received["oaisys_bridge/sample_info"]) == 2)
    user.wait_until(lambda: len(received["camera/depth_registered/points"]) == 2)
    (color,) = user.wait_until(lambda: received["camera/color/image_raw"])
    first, second = received["camera/depth_registered/points"]
    assert [str(c.header.stamp) for c in (first, second)] == [str(plain.stamp), str(colored.stamp)]
    points_m, colors = cloud_from_msg(first)
    np.testing.assert_allclose(points_m[..., 2], 5.0, rtol=1e-6)
    assert not colors.any()
    np.testing.assert_array_equal(cloud_from_msg(second)[1], image_from_msg(color))

    def newer(topic: str) -> list[Any]:
        """Return the messages of the third sample."""
        messages = [m.transforms[0] if topic == "/tf" else m for m in received[topic]]
        last_ns = nanoseconds(colored.stamp)
        return [m for m in messages if nanoseconds(m.header.stamp) > last_ns]

    def common_stamps() -> set[int]:
        """Return stamps that all messages with which a cloud can be made have."""
        topics = (*EARLY, "/tf")
        return set.intersection(*({nanoseconds(m.header.stamp) for m in newer(t)} for t in topics))

    pose = stamped(pose_looking_down(0, 0, 7))
    answer = user.begin(SetPose, "set_pose", SetPose.Request(pose=pose))
    user.wait_until(common_stamps)
    assert not answer.done()
    assert not any(newer(topic) for topic in LATE)
    assert len(common_stamps()) == 1
    depth_m = image_from_msg(newer("camera/depth/image_raw")[0])
    np.testing.assert_allclose(depth_m, 7.0, rtol=1e-6)

    assert user.call(StepBatch, "step_batch", StepBatch.Request(seed=5)).success
    user.wait_until(answer.done)
    assert not answer.result().success
    assert "overtaken" in answer.result().message
    assert not any(newer(topic) for topic in LATE)
