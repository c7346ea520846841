"""What RViz and Foxglove are told to show is in encodings that they can show."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import yaml
from repository import REPOSITORY
from ros_peer import Stage
from sensor_msgs.msg import CompressedImage, Image
from served_simulator import ROCKY_WORLD

from oaisys_core.geometry import pose_looking_at
from oaisys_ros_bridge.conversions import image_from_msg
from oaisys_ros_bridge.publishing.label_colors import color_ids
from oaisys_ros_bridge.qos import SENSOR_QOS

pytestmark = pytest.mark.ros

RVIZ = {
    "rgb8", "rgba8", "bgra8", "bgr8", "8UC4", "8SC4", "8UC3", "8SC3", "8UC1", "8SC1", "mono8",
    "16UC1", "16SC1", "mono16", "32FC1", "uyvy", "yuyv", "yuv422", "yuv422_yuy2",
}  # fmt: skip
"""ros2/rviz, jazzy: rviz_default_plugins/displays/image/ros_image_texture.cpp; Bayer left out."""
FOXGLOVE = {
    "rgb8", "rgba8", "bgra8", "bgr8", "8UC3", "32FC1", "mono8", "8UC1", "mono16", "16UC1",
    "uyvy", "yuyv", "yuv422", "yuv422_yuy2",
}  # fmt: skip
"""lichtblick-suite/lichtblick, from Foxglove Studio's last open source: decodeImage.ts; Bayer left
out."""


def rviz_topics() -> set[str]:
    rviz = yaml.safe_load((REPOSITORY / "config/simulator.rviz").read_text())
    displays = rviz["Visualization Manager"]["Displays"]
    return {d["Topic"]["Value"] for d in displays if d["Class"].endswith("/Image")}


def foxglove_topics() -> set[str]:
    panels = json.loads((REPOSITORY / "config/foxglove.json").read_text())["configById"]
    return {p["imageMode"]["imageTopic"] for name, p in panels.items() if name.startswith("Image!")}


@pytest.mark.long
def test_viewers_are_shown_encodings_that_they_accept(stage: Stage) -> None:
    user = stage.user
    shown = {"rviz": rviz_topics(), "foxglove": foxglove_topics()}
    assert all(len(topics) >= 4 for topics in shown.values())
    raw = ["/camera/semantic_0/image_raw", "/camera/instance/image_raw"]
    topics = sorted({*shown["rviz"], *shown["foxglove"], *raw})
    for topic in topics:
        kind: type[Any] = CompressedImage if topic.endswith("compressed") else Image
        user.listen(kind, topic, SENSOR_QOS)
    stage.start_bridge(stage.start_world(ROCKY_WORLD).address)
    user.wait_until_ready()
    assert user.set_pose(pose_looking_at((-4.0, 3.0, 6.0), (0.0, 0.0, 0.0))).success
    user.wait_until(lambda: all(user.received[topic] for topic in topics))
    newest = {topic: user.received[topic][0] for topic in topics}

    for viewer, accepted in (("rviz", RVIZ), ("foxglove", FOXGLOVE)):
        for topic in shown[viewer]:
            message = newest[topic]
            if isinstance(message, CompressedImage):
                assert message.format.endswith("jpeg compressed bgr8"), (viewer, topic)
            else:
                assert message.encoding in accepted, (viewer, topic)
    for topic in raw:
        ids = newest[topic]
        colors = newest[topic.replace("image_raw", "image_color")]
        assert (colors.header, colors.encoding) == (ids.header, "rgb8")
        check_colors(image_from_msg(ids), image_from_msg(colors))


def check_colors(ids: np.ndarray[Any, Any], colors: np.ndarray[Any, Any]) -> None:
    """One colour for each id, and a different one for each."""
    assert colors.shape == (*ids.shape, 3)
    by_id = {i: np.unique(colors[ids == i], axis=0) for i in np.unique(ids).tolist()}
    assert len(by_id) >= 2
    assert all(len(each) == 1 for each in by_id.values())
    assert len({tuple(each[0].tolist()) for each in by_id.values()}) == len(by_id)


def test_colors_of_ids_are_the_same_in_every_image() -> None:
    ids = np.array([[0, 1, 2], [7, 1243332042, 2**31 - 1]], np.uint32)
    colors = color_ids("instance", ids)
    assert colors[0, 0].tolist() == [0, 0, 0]
    assert len({tuple(each) for each in colors.reshape(-1, 3).tolist()}) == ids.size
    np.testing.assert_array_equal(color_ids("instance", ids[:, ::-1]), colors[:, ::-1])
    assert color_ids("semantic_0", np.zeros((2, 2), np.uint16))[0, 0].tolist() == [128, 128, 128]
