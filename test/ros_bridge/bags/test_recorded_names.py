"""Bags record topics under the names that they have on the wire, and none of another robot."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from ros_peer import Stage
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_ros_bridge.bags.rosbag2_command import rosbag2_command
from oaisys_ros_bridge.namespaces import OUTSIDE, namespace_arguments

pytestmark = pytest.mark.ros

DEPTH, MESSAGES = 10, 5
TRANSFORMS = ("/tf", "/mars/tf", "/lab/mars/tf")
ODOMETRIES = ("/odometry", "/mars/odometry", "/marsupial/odometry", "/lab/mars/odometry")


@pytest.fixture
def robots(stage: Stage) -> Stage:
    """Several robots in one graph, each of whose messages says on which topic it was."""
    node = stage.user.node
    publishers = [
        (node.create_publisher(TFMessage, name, QoSProfile(depth=DEPTH)), name)
        for name in TRANSFORMS
    ]
    others = [
        (node.create_publisher(Odometry, name, QoSProfile(depth=DEPTH)), name)
        for name in ODOMETRIES
    ]

    def publish() -> None:
        for publisher, name in publishers:
            transform = TransformStamped(header=Header(frame_id=name), child_frame_id="base_link")
            publisher.publish(TFMessage(transforms=[transform]))
        for publisher, name in others:
            publisher.publish(Odometry(header=Header(frame_id=name)))

    node.create_timer(0.05, publish)
    return stage


def check(stage: Stage, folder: Path, expected: tuple[str, ...], *arguments: str) -> None:
    """Record for a while; the bag has the expected topics, each with what was on it."""
    recorder = stage.start_node("recorder", "--out", str(folder), *arguments)
    node = stage.user.node
    stage.user.wait_until(lambda: all(map(node.count_subscribers, expected)))
    stage.user.wait_until(lambda: f"recording: {folder}" in recorder.log.read_text())
    stage.user.listen(Odometry, "/mars/odometry", QoSProfile(depth=DEPTH))
    stage.user.wait_until(lambda: len(stage.user.received["/mars/odometry"]) >= MESSAGES)
    assert recorder.end() == 0
    found: dict[str, set[str]] = {}
    with Reader(folder) as bag:
        topics = set(bag.topics)
    with AnyReader([folder]) as reader:
        for connection, _, data in reader.messages():
            if connection.topic not in (*TRANSFORMS, *ODOMETRIES):
                continue
            message = reader.deserialize(data, connection.msgtype)
            header = message.transforms[0].header if "tf" in connection.topic else message.header
            found.setdefault(connection.topic, set()).add(header.frame_id)
    assert topics & {*TRANSFORMS, *ODOMETRIES} == set(expected)
    assert found == {name: {name} for name in expected}


@pytest.mark.long
def test_a_namespace_with_its_own_tf_is_recorded_alone(robots: Stage, tmp_path: Path) -> None:
    check(robots, tmp_path / "bag", ("/mars/tf", "/mars/odometry"), *namespace_arguments("mars"))


@pytest.mark.long
def test_a_namespace_with_the_common_tf_is_recorded_with_that(
    robots: Stage, tmp_path: Path
) -> None:
    arguments = namespace_arguments("mars", has_own_tf=False)
    check(robots, tmp_path / "bag", ("/tf", "/mars/tf", "/mars/odometry"), *arguments)


@pytest.mark.long
def test_rules_rename_no_topic_in_the_bag(robots: Stage, tmp_path: Path) -> None:
    rules = ("--ros-args", "-r", "/tf:=/mars/tf", "-r", "/odometry:=/mars/odometry")
    check(robots, tmp_path / "bag", (*TRANSFORMS, *ODOMETRIES), *rules)


@pytest.mark.long
def test_a_topic_that_is_asked_for_is_the_remapped_one(robots: Stage, tmp_path: Path) -> None:
    arguments = ("--topics", "/tf", "odometry", *namespace_arguments("mars"))
    check(robots, tmp_path / "bag", ("/mars/tf", "/mars/odometry"), *arguments)


@pytest.mark.parametrize(
    ("namespace", "shared", "expected"),
    [
        ("mars", {"/clock", "/diagnostics"}, {"/mars/tf", "/mars/odometry", "/clock"}),
        ("mars", OUTSIDE, {"/tf", "/mars/tf", "/mars/odometry", "/clock"}),
        ("lab/mars", {"/clock"}, {"/lab/mars/tf", "/lab/mars/odometry", "/clock"}),
        ("", OUTSIDE, None),
    ],
)
def test_rosbag2_is_asked_for_the_same(
    namespace: str, shared: set[str], expected: set[str] | None
) -> None:
    command = rosbag2_command("bag", namespace, shared)
    named = dict(pairwise(command))
    assert named["--exclude-topic-types"] == "oaisys_msgs/msg/SampleReceipt"
    # rosbag2's topic_filter.cpp searches.
    assert re.search(named["--exclude-regex"], "/camera/color/image_raw/compressed")
    assert not re.search(named["--exclude-regex"], "/compressed/color/image_raw")
    if expected is None:
        assert command[-1] == "--all-topics"
        return
    names = (*TRANSFORMS, *ODOMETRIES, "/clock", "/mars_diagnostics", "/b/diagnostics")
    assert {name for name in names if re.search(named["--regex"], name)} == expected
