"""The recorder as a process: what was published is in a bag that other programs read."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from mcap.reader import make_reader
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import Image
from std_msgs.msg import Header, Int32
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import T_LINK_OPTICAL
from oaisys_msgs.msg import SemanticLabel, SemanticLabels
from oaisys_ros_bridge.bag_recovery import recover
from oaisys_ros_bridge.conversions import image_to_msg, transform_to_msg
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS

pytestmark = pytest.mark.ros

DEADLINE_S = 60.0
PIXELS = np.arange(480 * 640 * 3, dtype=np.uint32).astype(np.uint8).reshape(480, 640, 3)


class World:
    """A node whose topics are recorded: two latched ones, images, and one that comes late."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = Node("world", context=self.context)
        self.images = self.node.create_publisher(Image, "camera/color/image_raw", SENSOR_QOS)
        frames = self.node.create_publisher(TFMessage, "/tf_static", LATCHED_QOS)
        header = Header(frame_id="camera_link")
        transform = transform_to_msg(T_LINK_OPTICAL, header, "camera_optical_frame")
        frames.publish(TFMessage(transforms=[transform]))
        labels = self.node.create_publisher(SemanticLabels, "camera/semantic_0/labels", LATCHED_QOS)
        labels.publish(SemanticLabels(labels=[SemanticLabel(id=10, name="rock")]))

    def publish_images(self, count: int) -> None:
        # Discovery has two sides: the recorder may know this publisher before it is known to it.
        wait_until(lambda: self.images.get_subscription_count() == 1)
        for second in range(count):
            header = Header(stamp=Time(sec=second), frame_id="camera_optical_frame")
            self.images.publish(image_to_msg(PIXELS, "rgb8", header))
            assert self.images.wait_for_all_acked(rclpy.duration.Duration(seconds=DEADLINE_S))

    def publish_late(self, count: int) -> None:
        publisher = self.node.create_publisher(Int32, "late", QoSProfile(depth=count))
        wait_until(lambda: publisher.get_subscription_count() == 1)
        for number in range(count):
            publisher.publish(Int32(data=number))
        assert publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=DEADLINE_S))

    def close(self) -> None:
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def world(ros_domain_id: int, no_process_left: None) -> Iterator[World]:
    made = World()
    yield made
    made.close()


def wait_until(is_so: Callable[[], bool]) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not is_so():
        assert time.monotonic() < end_s, "waited too long"
        time.sleep(0.02)


def started_recorder(*arguments: str) -> subprocess.Popen[str]:
    """Return a recorder that says it records."""
    process = subprocess.Popen(
        [sys.executable, "-m", "oaisys_ros_bridge.nodes.recorder", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("recording: "), process.communicate(timeout=DEADLINE_S)
    return process


def ended(process: subprocess.Popen[str], number: int) -> tuple[int, str]:
    """End a process with a signal; return its exit code and what it said."""
    process.send_signal(number)
    _, said = process.communicate(timeout=DEADLINE_S)
    return process.returncode, said


def messages_of(reader: AnyReader, topic: str) -> list[Any]:
    connections = [c for c in reader.connections if c.topic == topic]
    return [
        reader.deserialize(data, connection.msgtype)
        for connection, _, data in reader.messages(connections)
    ]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_rosbags_reads_every_topic_with_its_type_and_all_its_messages(world, tmp_path, number):
    bag = tmp_path / "bag"
    process = started_recorder("--out", str(bag))
    world.publish_images(5)
    world.publish_late(30)

    code, said = ended(process, number)

    assert code == 0
    assert "Traceback" not in said
    # No type store is given: the definitions in the bag must do.
    with AnyReader([bag]) as reader:
        topics = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
        assert topics["/camera/color/image_raw"] == ("sensor_msgs/msg/Image", 5)
        assert topics["/camera/semantic_0/labels"] == ("oaisys_msgs/msg/SemanticLabels", 1)
        assert topics["/tf_static"] == ("tf2_msgs/msg/TFMessage", 1)
        assert topics["/late"] == ("std_msgs/msg/Int32", 30)
        images = messages_of(reader, "/camera/color/image_raw")
        assert [image.header.stamp.sec for image in images] == [0, 1, 2, 3, 4]
        assert all(np.array_equal(image.data, PIXELS.ravel()) for image in images)
        assert [number.data for number in messages_of(reader, "/late")] == list(range(30))
        (legend,) = messages_of(reader, "/camera/semantic_0/labels")
        assert [(label.id, label.name) for label in legend.labels] == [(10, "rock")]
        (static,) = messages_of(reader, "/tf_static")
        assert static.transforms[0].child_frame_id == "camera_optical_frame"


def test_only_what_was_asked_for_is_recorded(world, tmp_path):
    bag = tmp_path / "bag"
    process = started_recorder("--out", str(bag), "--topics", "/camera/color/image_raw")
    world.publish_images(2)

    ended(process, signal.SIGINT)

    with AnyReader([bag]) as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == {"/camera/color/image_raw": 2}


def test_the_recorded_hash_is_the_one_of_the_running_type(world, tmp_path):
    bag = tmp_path / "bag"
    process = started_recorder("--out", str(bag), "--topics", "/camera/color/image_raw")
    offered = world.node.get_publishers_info_by_topic("/camera/color/image_raw")[0]
    ended(process, signal.SIGINT)

    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()

    assert summary is not None
    (channel,) = summary.channels.values()
    recorded = channel.metadata["topic_type_hash"]
    assert recorded.startswith("RIHS01_")
    assert recorded == str(offered.topic_type_hash)


def test_a_killed_recorder_loses_nothing_that_it_had_taken(world, tmp_path):
    bag = tmp_path / "bag"
    process = started_recorder("--out", str(bag), "--topics", "/camera/color/image_raw")
    world.publish_images(3)
    (file,) = bag.glob("*.mcap")
    wait_until(lambda: recover(file, tmp_path / f"try{time.monotonic_ns()}") == 3)

    os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=DEADLINE_S)

    assert recover(file, tmp_path / "saved") == 3
    with AnyReader([tmp_path / "saved"]) as reader:
        images = messages_of(reader, "/camera/color/image_raw")
    assert [image.header.stamp.sec for image in images] == [0, 1, 2]


def test_a_folder_with_something_in_it_is_left_alone(ros_domain_id, tmp_path):
    (tmp_path / "diary.txt").write_text("mine")

    process = subprocess.run(
        [sys.executable, "-m", "oaisys_ros_bridge.nodes.recorder", "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )

    assert process.returncode == 2
    assert str(tmp_path) in process.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["diary.txt"]
