"""The recorder's bags, opened with an independent reader."""

from __future__ import annotations

import errno
import shutil
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator
from io import FileIO
from pathlib import Path

import numpy as np
import pytest
import rclpy
import yaml
from builtin_interfaces.msg import Time
from commands import oaisys_here
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_peer import LATCHED_TYPES, SAMPLE_TYPES, NodeProcess, Stage, messages_of_samples
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, TopicInfo
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import Image, Imu
from served_simulator import FLAT_WORLD
from std_msgs.msg import Header
from waiting import wait_until

from oaisys_core.geometry import pose_looking_down
from oaisys_msgs.msg import SampleInfo
from oaisys_msgs.srv import GetNewestSample
from oaisys_ros_bridge.bags.info import losses_of
from oaisys_ros_bridge.bags.losses import BagLosses
from oaisys_ros_bridge.bags.mcap_format import mcap_writer
from oaisys_ros_bridge.bags.mcap_format.message_definition import (
    field_types,
    message_definition,
    type_hash,
)
from oaisys_ros_bridge.conversions import image_from_msg, stamp_from_nanoseconds
from oaisys_ros_bridge.nodes import recorder as recorder_module
from oaisys_ros_bridge.nodes.recorder import RecorderNode
from oaisys_ros_bridge.qos import MOTION_QOS, SENSOR_QOS, SMALL_MESSAGE_QOS

VIEWS = 3


def wait_for_line(stage: Stage, recorder: NodeProcess, line: str) -> None:
    stage.user.wait_until(lambda: line in recorder.log.read_text().splitlines())


@pytest.fixture(scope="module")
def bridged(shared_stage: Stage) -> Stage:
    """A stage with a bridge, whose user listens to depth."""
    shared_stage.user.listen(Image, "camera/depth/image_raw", SENSOR_QOS)
    shared_stage.start_bridge(shared_stage.start_world(FLAT_WORLD).address)
    shared_stage.user.wait_until_ready()
    return shared_stage


def record_views(
    stage: Stage, folder: Path, topics: Collection[str], *options: str
) -> tuple[NodeProcess, list[Image]]:
    """Record topics while `VIEWS` views are taken; return the depth images as a user gets them."""
    images = stage.user.received["camera/depth/image_raw"]
    images.clear()
    recorder = stage.start_node("recorder", "--out", str(folder), *options, "--topics", *topics)
    wait_for_line(stage, recorder, f"recording: {folder}")
    stage.user.wait_until_matched(SAMPLE_TYPES.keys() & set(topics))
    # Its other subscriber is the user.
    stage.user.wait_until_matched(["/camera/depth/image_raw"], subscribers=2)
    for index in range(VIEWS):
        answer = stage.user.set_pose(pose_looking_down(float(index), 0.0, 5.0))
        assert answer.success, answer.message
    stage.user.wait_until(lambda: len(images) == VIEWS)
    return recorder, images


@pytest.mark.ros
def test_a_bag_holds_all_topics_with_their_types_and_counts(bridged: Stage, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    expected = SAMPLE_TYPES | LATCHED_TYPES
    recorder, images = record_views(bridged, folder, expected, "--all")

    assert recorder.end() == 0

    assert "Traceback" not in recorder.log.read_text()
    with Reader(folder) as reader:
        topics: dict[str, TopicInfo] = reader.topics
        counts = messages_of_samples(folder)
        for name, type_name in SAMPLE_TYPES.items():
            assert (topics[name].msgtype, counts[name]) == (type_name, VIEWS), name
        assert topics["/diagnostics"].msgtype == "diagnostic_msgs/msg/DiagnosticArray"
        for name, type_name in LATCHED_TYPES.items():
            # Published before the recorder came.
            assert topics[name].msgtype == type_name
            assert topics[name].msgcount == 1
            assert topics[name].connections[0].ext.offered_qos_profiles[0].durability == (
                QosDurability.TRANSIENT_LOCAL
            )
        read = sum(1 for _ in reader.messages())
        assert read == reader.message_count == sum(t.msgcount for t in topics.values())
    with AnyReader([folder]) as decoder:
        depth = [c for c in decoder.connections if c.topic == "/camera/depth/image_raw"]
        decoded = [decoder.deserialize(raw, c.msgtype) for c, _, raw in decoder.messages(depth)]
    for image, original in zip(decoded, images, strict=True):
        assert image.header.stamp.nanosec == original.header.stamp.nanosec
        depth_m = image.data.view(np.float32).reshape(image.height, image.width)
        np.testing.assert_array_equal(depth_m, image_from_msg(original))


@pytest.mark.long
@pytest.mark.ros
def test_a_killed_recorder_leaves_what_it_had_taken(bridged: Stage, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    wanted = ["/camera/depth/image_raw", "/oaisys_bridge/sample_info"]
    recorder, _ = record_views(bridged, folder, wanted)
    file = folder / "bag_0.mcap"

    def taken() -> list[str]:
        try:
            with file.open("rb") as stream:
                found = NonSeekingReader(stream).iter_messages(log_time_order=False)
                topics = []
                for _, channel, _ in found:
                    topics.append(channel.topic)
        except EndOfFile:
            pass
        return topics

    bridged.user.wait_until(lambda: len(taken()) == 2 * VIEWS)
    recorder.end(signal.SIGKILL)

    assert sorted(taken()) == ["/camera/depth/image_raw"] * VIEWS + [wanted[1]] * VIEWS
    assert not (folder / "metadata.yaml").exists()
    told = oaisys_here("bag", "recover", folder, "--out", tmp_path / "saved")
    assert told.stdout.strip() == f"{tmp_path / 'saved'}: {2 * VIEWS} messages"
    with Reader(tmp_path / "saved") as reader:
        assert {name: t.msgcount for name, t in reader.topics.items()} == dict.fromkeys(
            wanted, VIEWS
        )


@pytest.mark.long
@pytest.mark.ros
def test_what_a_full_queue_drops_of_an_imu_is_counted(stage: Stage, tmp_path: Path) -> None:
    folder, imu = tmp_path / "bag", Imu()
    publisher = stage.user.node.create_publisher(Imu, "imu/data_raw", MOTION_QOS)
    recorder = stage.start_node("recorder", "--out", str(folder), "--topics", "imu/data_raw")
    wait_for_line(stage, recorder, f"recording: {folder}")
    stage.user.wait_until(lambda: publisher.get_subscription_count() == 1)
    file = folder / "bag_0.mcap"
    before = file.stat().st_size
    publisher.publish(imu)
    stage.user.wait_until(lambda: file.stat().st_size > before)

    recorder.process.send_signal(signal.SIGSTOP)
    sent = MOTION_QOS.depth + 1000
    for _ in range(sent):
        publisher.publish(imu)
    recorder.process.send_signal(signal.SIGCONT)
    publisher.publish(Imu(header=Header(frame_id="the_last")))
    stage.user.wait_until(lambda: b"the_last" in file.read_bytes()[-4096:])
    assert recorder.end() == 0

    metadata = yaml.safe_load((folder / "metadata.yaml").read_text())
    losses = BagLosses.read(metadata["rosbag2_bagfile_information"]["custom_data"])
    with Reader(folder) as reader:
        written = reader.topics["/imu/data_raw"].msgcount
    assert written < 2 + sent, "it was stopped"
    assert losses.lost_by_middleware == {"/imu/data_raw": 2 + sent - written}
    assert "the middleware lost messages of /imu/data_raw" in recorder.log.read_text()


@pytest.fixture
def started_ros(ros_domain_id: int) -> Iterator[None]:
    """ROS in this process."""
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.mark.ros
def test_a_sample_whose_announcement_comes_after_the_end_was_asked_for_is_recorded(
    stage: Stage, tmp_path: Path
) -> None:
    """The recorder waited for half a second without a message, and closed the bag."""
    user, folder, topic = stage.user, tmp_path / "bag", "oaisys_bridge/sample_info"
    bridge, asked = Node("oaisys_bridge", context=user.node.context), []
    user.spin_with(bridge)
    announced = bridge.create_publisher(SampleInfo, topic, SMALL_MESSAGE_QOS)

    def answer(_: object, newest: GetNewestSample.Response) -> GetNewestSample.Response:
        asked.append(time.monotonic())
        newest.success, newest.sequence, newest.stamp = True, 2, Time(sec=2)
        newest.published = stamp_from_nanoseconds(time.time_ns())
        return newest

    bridge.create_service(GetNewestSample, "~/get_newest_sample", answer)
    recorder = stage.start_node("recorder", "--out", str(folder), "--topics", topic)
    wait_for_line(stage, recorder, f"recording: {folder}")
    user.wait_until(lambda: announced.get_subscription_count() == 2)
    announced.publish(SampleInfo(header=Header(stamp=Time(sec=1)), sequence=1))

    recorder.process.send_signal(signal.SIGINT)
    user.wait_until(lambda: asked)
    late_s = asked[0] + 2 * recorder_module.QUIET_LOOKS * recorder_module.END_LOOK_S
    user.wait_until(lambda: time.monotonic() > late_s)
    announced.publish(SampleInfo(header=Header(stamp=Time(sec=2)), sequence=2))
    user.wait_until(lambda: recorder.process.poll() is not None)
    bridge.destroy_node()

    assert recorder.process.returncode == 0
    with Reader(folder) as reader:
        assert reader.topics[f"/{topic}"].msgcount == 2
    assert losses_of(folder) == BagLosses(announced=2)


@pytest.mark.ros
def test_what_comes_after_a_write_error_is_counted_and_nothing_more_is_found(
    started_ros: None, stage: Stage, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """It was dropped without a word, and "all is well" was the last line."""
    bag, stop, create = tmp_path / "bag", threading.Event(), stage.user.node.create_publisher
    publisher = create(Imu, "imu/data_raw", MOTION_QOS)
    recorder = RecorderNode(stop, path=str(bag), topics=["imu/data_raw"], all=True)
    executor = SingleThreadedExecutor()
    executor.add_node(recorder)

    def spin_until(condition: Callable[[], bool]) -> None:
        wait_until(condition, pause=lambda: executor.spin_once(timeout_sec=0.05))

    spin_until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(Imu())
    spin_until(lambda: recorder._bag.message_count >= 1)
    shutil.rmtree(bag)
    for _ in range(3):
        publisher.publish(Imu())
    spin_until(stop.is_set)
    create(Image, "later/image_raw", SENSOR_QOS)
    spin_until(lambda: recorder.count_publishers("later/image_raw") == 1)
    recorder._discover()
    publisher.publish(Imu())

    recorder.close()
    executor.shutdown()
    recorder.destroy_node()

    assert "No such file" in recorder.fault
    assert recorder._losses.unwritten["/imu/data_raw"] == 4
    last = capfd.readouterr().err.splitlines()[-1]
    assert f"messages in {bag} are gone with its file" in last
    assert f"the recording has failed: {recorder.fault}" in last


@pytest.mark.ros
def test_a_topic_that_cannot_be_added_ends_the_recording_in_words(
    started_ros: None, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The node ended with a traceback."""
    stop = threading.Event()
    publisher = stage.user.node.create_publisher(Imu, "imu/data_raw", MOTION_QOS)
    recorder = RecorderNode(stop, path=str(tmp_path / "bag"), topics=["imu/data_raw"])

    def refuse(_file: FileIO, _data: bytes) -> None:
        raise OSError(errno.EDQUOT, "Disk quota exceeded")

    monkeypatch.setattr(mcap_writer, "_write_all", refuse)
    wait_until(lambda: recorder.count_publishers(publisher.topic_name) == 1)
    recorder._discover()
    recorder.close()
    recorder.destroy_node()

    assert stop.is_set()
    assert "Disk quota exceeded" in recorder.fault


@pytest.mark.ros
@pytest.mark.parametrize("longest_s", [recorder_module.LONGEST_END_S, 0.0])
def test_what_waits_at_the_end_is_written_or_counted(
    started_ros: None,
    stage: Stage,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    longest_s: float,
) -> None:
    monkeypatch.setattr(recorder_module, "LONGEST_END_S", longest_s)
    monkeypatch.setattr(recorder_module, "QUIET_LOOKS", 5)
    sent = 1000
    publisher = stage.user.node.create_publisher(Imu, "imu/data_raw", MOTION_QOS)
    recorder = RecorderNode(threading.Event(), path=str(tmp_path / "bag"), topics=["imu/data_raw"])
    executor = SingleThreadedExecutor()
    executor.add_node(recorder)
    wait_until(
        lambda: publisher.get_subscription_count() == 1,
        pause=lambda: executor.spin_once(timeout_sec=0.05),
    )
    executor.remove_node(recorder)  # nobody else takes the messages
    for _ in range(sent):
        publisher.publish(Imu())

    recorder.close()

    with Reader(tmp_path / "bag") as reader:
        written = reader.topics["/imu/data_raw"].msgcount
    losses = losses_of(tmp_path / "bag")
    assert losses is not None
    expected = {} if longest_s else {"/imu/data_raw": sent}
    assert losses.unwritten == expected
    assert written + sum(expected.values()) == sent
    assert losses.any is bool(expected)
    recorder.destroy_node()


@pytest.mark.ros
def test_a_bag_is_finished_although_what_waits_cannot_be_taken(
    started_ros: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = RecorderNode(threading.Event(), path=str(tmp_path / "bag"), topics=["imu/data_raw"])

    def fail() -> None:
        raise RuntimeError("failed to take")

    monkeypatch.setattr(recorder, "_take_waiting", fail)
    with pytest.raises(RuntimeError, match="failed to take"):
        recorder.close()
    assert losses_of(tmp_path / "bag") is not None
    recorder.destroy_node()


@pytest.mark.long
@pytest.mark.ros
def test_topics_that_are_asked_for_are_waited_for(stage: Stage, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    recorder = stage.start_node("recorder", "--out", str(folder), "--topics", "here", "/later")
    here = stage.user.node.create_publisher(Image, "here", 5)
    stage.user.wait_until(lambda: here.get_subscription_count() == 1)
    stage.user.wait_until(lambda: "nobody publishes /later yet" in recorder.log.read_text())
    assert "recording:" not in recorder.log.read_text()

    later = stage.user.node.create_publisher(Image, "later", 5)
    wait_for_line(stage, recorder, f"recording: {folder}")
    stage.user.wait_until(lambda: later.get_subscription_count() == 1)
    later.publish(Image(width=3))
    assert recorder.end(signal.SIGTERM) == 0

    with Reader(folder) as reader:
        assert {name: t.msgcount for name, t in reader.topics.items()} == {"/here": 0, "/later": 1}


@pytest.mark.ros
def test_without_names_it_records_what_appears_but_nothing_hidden(
    stage: Stage, tmp_path: Path
) -> None:
    recorder = stage.start_node("recorder", "--out", str(tmp_path / "bag"))
    publishers = [stage.user.node.create_publisher(Image, n, 5) for n in ("seen", "_hidden")]
    stage.user.wait_until(lambda: publishers[0].get_subscription_count() == 1)
    wait_for_line(stage, recorder, f"recording: {tmp_path / 'bag'}")
    for publisher in publishers:
        publisher.publish(Image())
    assert recorder.end() == 0

    with Reader(tmp_path / "bag") as reader:
        assert reader.topics["/seen"].msgcount == 1
        assert "/_hidden" not in reader.topics


@pytest.mark.ros
def test_a_folder_with_something_in_it_is_refused(stage: Stage, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").touch()

    recorder = stage.start_node("recorder", "--out", str(tmp_path / "bag"))

    assert recorder.process.wait(60) == 2
    assert recorder.log.read_text().splitlines() == [
        f"path: received '{tmp_path / 'bag'}', expected a folder that is new or empty"
    ]


@pytest.mark.parametrize(
    "name",
    [
        "diagnostic_msgs/msg/DiagnosticArray",
        "nav_msgs/msg/Odometry",
        "rcl_interfaces/msg/ParameterEvent",
        "sensor_msgs/msg/PointCloud2",
        "tf2_msgs/msg/TFMessage",
        "visualization_msgs/msg/Marker",
    ],
)
def test_definitions_and_hashes_agree_with_another_implementation(name: str) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    definition, _ = store.generate_msgdef(name, ros_version=2)

    assert type_hash(name) == store.hash_rihs01(name)
    assert definition.count("MSG: ") == message_definition(name).count("\nMSG: ")


def test_only_fields_of_message_types_are_nested() -> None:
    definition = """
    # comment pkg/Type x
    uint8 OK=0
    string<=10 name
    float64[9] k
    geometry_msgs/Point[] points
    Own[<=4] own  # comment
    wstring text "default"
    """
    nested = field_types("my_msgs/msg/Whole", definition)
    assert nested == ["geometry_msgs/msg/Point", "my_msgs/msg/Own"]
