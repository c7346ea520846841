"""Bags published again: the same messages in the same order, and from them the same map."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from ros_peer import SAMPLE_TYPES, Stage
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from served_simulator import ROCKY_WORLD
from std_msgs.msg import String
from waiting import LOAD_FACTOR

from oaisys_core.geometry import pose_looking_down
from oaisys_msgs.msg import MapStatus
from oaisys_msgs.srv import SaveMesh
from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic, qos_entry
from oaisys_ros_bridge.nodes.player import MAX_TOPICS
from oaisys_ros_bridge.qos import LATCHED_QOS

METRICS = "oaisys_mapper/metrics"
PLACES = [(-3.0, -2.0), (0.0, -2.0), (3.0, -2.0), (3.0, 2.0), (0.0, 2.0)]
MAPPER_READS = [
    *(
        f"/camera/{kind}/{what}"
        for kind in ("color", "depth")
        for what in ("image_raw", "camera_info")
    ),
    "/oaisys_bridge/sample_info",
    "/tf",
    "/tf_static",
]
RELIABLE_QOS = QoSProfile(depth=50)
RELIABLE = qos_entry(depth=5, reliable=True, transient_local=False)
LATCHED = qos_entry(depth=1, reliable=True, transient_local=True)


PATIENCE = ("--wait-timeout", "100")
"""Of the replay, for a machine that is busy."""


def replay(bag: Path, *options: str, status: int = 0) -> tuple[str, str]:
    """Play a bag to its end; return what it printed and what it logged."""
    command = ["oaisys", "bag", "replay", str(bag), *options]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert ended.returncode == status, ended.stderr
    assert "Traceback" not in ended.stderr
    return ended.stdout, ended.stderr


def map_of(stage: Stage, file: Path) -> bytes:
    """Return what the mapper saves once it has all views."""
    statuses = stage.user.received[METRICS]
    stage.user.wait_until(lambda: statuses and statuses[-1].frames_integrated == len(PLACES))
    client = stage.user.client(SaveMesh, "oaisys_mapper/save_mesh")
    answer = stage.user.answer(client.call_async(SaveMesh.Request(path=str(file))))
    assert answer.success, answer.message
    assert answer.frames == len(PLACES)
    return file.read_bytes()


@pytest.mark.long
@pytest.mark.ros
def test_a_replayed_bag_gives_the_same_map_byte_for_byte(stage: Stage, tmp_path: Path) -> None:
    stage.user.listen(MapStatus, METRICS, LATCHED_QOS)
    bridge = stage.start_bridge(stage.start_world(ROCKY_WORLD).address)
    mapper = stage.start_node("mapper")
    stage.user.wait_until_ready()
    bag = tmp_path / "bag"
    wanted = [*SAMPLE_TYPES, "/tf_static"]
    recorder = stage.start_node("recorder", "--out", str(bag), "--topics", *wanted)
    stage.user.wait_until(lambda: f"recording: {bag}" in recorder.log.read_text())
    stage.user.wait_until_matched(SAMPLE_TYPES)
    stage.user.wait_until_matched(["/camera/depth/image_raw", "/tf"], subscribers=2)
    for x_m, y_m in PLACES:
        answer = stage.user.set_pose(pose_looking_down(x_m, y_m, 8.0, yaw_rad=x_m))
        assert answer.success, answer.message
    live = map_of(stage, tmp_path / "live.npz")
    for node in (recorder, bridge, mapper):
        assert node.end() == 0

    stage.user.received[METRICS].clear()
    stage.start_node("mapper")
    stage.user.wait_until(lambda: stage.user.received[METRICS])
    awaited = [o for t in MAPPER_READS for o in ("--wait-for-topic", t)]
    told, _ = replay(bag, *PATIENCE, *awaited)

    assert f"/camera/depth/image_raw: {len(PLACES)} messages, 1 reader, acknowledged\n" in told
    assert f"/camera/instance/image_raw: {len(PLACES)} messages, no reader\n" in told
    assert map_of(stage, tmp_path / "replayed.npz") == live


@pytest.fixture
def small_bag(tmp_path: Path) -> Path:
    """Return a bag with one latched message and five others, a tenth of a second apart."""
    folder = tmp_path / "small"
    with BagWriter(folder) as bag:
        bag.add_topic(RecordedTopic("/latched", "std_msgs/msg/String", (LATCHED,)))
        bag.add_topic(RecordedTopic("/plain", "std_msgs/msg/String", (RELIABLE,)))
        start_ns = 1_000_000_000_000
        bag.write("/latched", serialize_message(String(data="first")), start_ns, start_ns)
        for i in range(1, 6):
            at_ns = start_ns + i * 100_000_000
            bag.write("/plain", serialize_message(String(data=str(i))), at_ns, at_ns)
    return folder


@pytest.mark.ros
def test_messages_come_in_order_with_their_qos_and_the_clock(stage: Stage, small_bag: Path) -> None:
    stage.user.listen(String, "/moved", RELIABLE_QOS)
    stage.user.listen(String, "/latched", LATCHED_QOS)
    stage.user.listen(Clock, "/clock", RELIABLE_QOS)
    command = ["bag", "replay", str(small_bag), *PATIENCE]
    command += ["--clock", "50", "--remap", "/plain:=/moved"]
    with subprocess.Popen(["oaisys", *command], start_new_session=True) as player:
        stage.user.wait_until(lambda: len(stage.user.received["/moved"]) == 5)
        stage.user.wait_until(lambda: player.poll() is not None)
    assert player.returncode == 0

    assert [m.data for m in stage.user.received["/moved"]] == list("12345")
    # Only a publisher that is latched, too, is heard by one who asks for that.
    assert [m.data for m in stage.user.received["/latched"]] == ["first"]
    times = [m.clock.sec * 10**9 + m.clock.nanosec for m in stage.user.received["/clock"]]
    assert times == sorted(times)
    assert 1_000_000_000_000 <= times[0] <= times[-1] <= 1_000_500_000_001


@pytest.mark.ros
def test_a_part_of_a_bag_is_played_over_and_over(stage: Stage, small_bag: Path) -> None:
    stage.user.listen(String, "/plain", RELIABLE_QOS)
    options = ["--loop", "--rate", "100", "--topics", "/plain", *PATIENCE]
    command = ["oaisys", "bag", "replay", str(small_bag), *options]
    with subprocess.Popen(command, start_new_session=True) as player:
        stage.user.wait_until(lambda: len(stage.user.received["/plain"]) > 12)
        assert stage.user.node.count_publishers("/latched") == 0
        player.send_signal(2)
        assert player.wait(60) == 0
    assert [m.data for m in stage.user.received["/plain"][:12]] == [*"12345"] * 2 + [*"12"]


@pytest.mark.long
@pytest.mark.ros
def test_nodes_that_come_late_are_waited_for(stage: Stage, small_bag: Path) -> None:
    """They come seconds after the player; one node's two subscriptions are one reader."""
    options = ["--wait-for", "2", "--rate", "100", *PATIENCE]
    command = ["oaisys", "bag", "replay", str(small_bag), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as player:
        stage.user.wait_until(lambda: stage.user.node.count_publishers("/plain"))
        stage.user.listen(String, "/plain", RELIABLE_QOS)
        stage.user.listen(String, "/latched", RELIABLE_QOS)
        calm_s = time.monotonic() + 4.0
        stage.user.wait_until(lambda: time.monotonic() > calm_s)
        assert player.poll() is None
        assert not stage.user.received["/plain"]
        second = Node("second", context=stage.user.node.context)
        stage.user.spin_with(second)
        heard: list[String] = []
        second.create_subscription(String, "/plain", heard.append, RELIABLE_QOS)
        stage.user.wait_until(lambda: player.poll() is not None)
        told = player.communicate()[0]
    assert player.returncode == 0
    assert [m.data for m in stage.user.received["/plain"]] == list("12345")
    assert [m.data for m in heard] == list("12345")
    assert [m.data for m in stage.user.received["/latched"]] == ["first"]
    assert "/latched: 1 message, 1 reader, acknowledged\n" in told
    assert "/plain: 5 messages, 2 readers, acknowledged\n" in told


@pytest.mark.long
@pytest.mark.ros
def test_it_says_which_messages_went_to_fewer_readers(stage: Stage, small_bag: Path) -> None:
    """It said of a second reader that came at the fourth message that it got all of them."""
    options = ["--rate", "0.1", "--wait-for-topic", "/plain", *PATIENCE]
    command = ["oaisys", "bag", "replay", str(small_bag), *options]
    stage.user.listen(String, "/plain", RELIABLE_QOS)
    late: list[String] = []
    latched: list[String] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as player:
        stage.user.wait_until(lambda: stage.user.received["/plain"])
        stage.user.node.create_subscription(String, "/plain", late.append, RELIABLE_QOS)
        stage.user.node.create_subscription(String, "/latched", latched.append, LATCHED_QOS)
        stage.user.wait_until(lambda: player.poll() is not None)
        told = player.communicate()[0]
    assert 0 < len(late) < 5 == len(stage.user.received["/plain"])
    missed = f"{5 - len(late)} message{'s' if len(late) < 4 else ''}"
    assert f"/plain: 5 messages, 2 readers, but {missed} to only 1, acknowledged\n" in told
    assert [m.data for m in latched] == ["first"]
    assert "/latched: 1 message, 1 reader, acknowledged\n" in told


@pytest.mark.ros
def test_readers_with_best_effort_acknowledge_nothing(stage: Stage, small_bag: Path) -> None:
    """It said that they acknowledged everything."""
    best_effort = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
    stage.user.listen(String, "/plain", RELIABLE_QOS)
    subscribe = partial(stage.user.node.create_subscription, String)
    subscribe("/plain", stage.user.received["/plain"].append, best_effort)
    subscribe("/latched", lambda _: None, best_effort)
    told, _ = replay(small_bag, "--rate", "100", "--wait-for", "1", "--delay", "1", *PATIENCE)
    assert "/plain: 5 messages, 2 readers, acknowledged by 1, best effort to 1\n" in told
    nothing = "best effort, which acknowledges nothing"
    assert f"/latched: 1 message, 1 reader, {nothing}\n" in told


@pytest.mark.long
@pytest.mark.ros
def test_topics_without_a_reader_are_named(stage: Stage, small_bag: Path) -> None:
    stage.user.listen(String, "/plain", RELIABLE_QOS)
    options = ["--rate", "100", "--wait-timeout", "5"]
    command = ["oaisys", "bag", "replay", str(small_bag), *options]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as player:
        stage.user.wait_until(lambda: player.poll() is not None)
        told, logged = player.communicate()
    assert player.returncode == 0
    assert "nobody reads /latched" in logged
    assert "nobody reads /plain" not in logged
    assert "/latched: 1 message, no reader\n" in told
    assert "/plain: 5 messages, 1 reader, acknowledged\n" in told


@pytest.mark.ros
@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ([], "waited 0.5 s for readers of /latched, /plain"),
        pytest.param(
            ["--topics", "/plain"], "waited 0.5 s for readers of /plain", marks=pytest.mark.long
        ),
        pytest.param(
            ["--wait-for-topic", "/latched"],
            "waited 0.5 s for readers of /latched",
            marks=pytest.mark.long,
        ),
        (["--wait-for", "3"], "waited 0.5 s for readers: 0 of 3 nodes are there"),
        pytest.param(
            ["--wait-for", "1", "--delay", "0.1"],
            "waited 0.5 s for readers: 0 of 1 nodes are there",
            marks=pytest.mark.soak,
        ),
        pytest.param(
            ["--wait-for-topic", "/latched", "--delay", "0.1"],
            "waited 0.5 s for readers of /latched",
            marks=pytest.mark.soak,
        ),
        (["--delay", "0.5"], "was played to nobody: no topic had a reader"),
    ],
)
def test_playing_to_nobody_is_no_success(
    options: list[str], reason: str, small_bag: Path, ros_domain_id: int
) -> None:
    told, logged = replay(small_bag, "--rate", "100", "--wait-timeout", "0.5", *options, status=1)
    assert reason in logged
    if options == ["--delay", "0.5"]:
        assert "nobody reads /plain" in logged
        assert "/plain: 5 messages, no reader\n" in told


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (["nowhere"], "expected a folder with .mcap files"),
        (["small", "--topics", "/other"], "the bag has no topic /other"),
        (["small", "--rate", "0"], "rate"),
    ],
)
def test_what_cannot_be_played_is_refused(
    options: list[str], fault: str, small_bag: Path, ros_domain_id: int
) -> None:
    command = ["oaisys", "bag", "replay", *options]
    result: Any = subprocess.run(
        command, cwd=small_bag.parent, capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 2, result.stderr
    assert fault in result.stderr
    assert "Traceback" not in result.stderr


def bag_of_topics(folder: Path, names: Iterable[str], kind: str = "std_msgs/msg/String") -> Path:
    """Write a bag with a message of each topic, a millisecond apart, with mcap's own writer."""
    data = serialize_message(String(data="text"))
    file = folder / "topics.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2msg", b"string data")
        for number, name in enumerate(names):
            channel = writer.register_channel(name, "cdr", schema)
            writer.add_message(channel, number * 10**6, data, 0)
        writer.finish()
    return file


@pytest.mark.ros
def test_a_bag_of_very_many_topics_is_refused_unless_some_are_chosen(
    tmp_path: Path, ros_domain_id: int
) -> None:
    file = bag_of_topics(tmp_path, (f"/topic_{i}" for i in range(MAX_TOPICS + 1)))
    start_s = time.monotonic()
    _, logged = replay(file, status=2)
    assert time.monotonic() - start_s < 10 * LOAD_FACTOR
    assert f"topics: received '{MAX_TOPICS + 1} topics of " in logged
    assert f"at most {MAX_TOPICS} of them, chosen by --topics" in logged
    _, logged = replay(file, "--topics", "/topic_7", "--delay", "0.1", status=1)
    assert "nobody reads /topic_7" in logged
    _, logged = replay(file, "--topics", "/other", status=2)
    assert len(logged) < 1000
    assert "the bag has no topic /other, but /topic_0, /topic_1, " in logged


@pytest.mark.ros
def test_a_replay_of_many_topics_ends_within_seconds_of_a_signal(
    tmp_path: Path, ros_domain_id: int
) -> None:
    file = bag_of_topics(tmp_path, (f"/topic_{i}" for i in range(MAX_TOPICS)))
    command = ["oaisys", "bag", "replay", str(file), "--wait-timeout", "600"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as player:
        assert player.stderr is not None
        waiting = next(line for line in player.stderr if "waiting for readers of" in line)
        assert f"and {MAX_TOPICS - 20} more" in waiting
        start_s = time.monotonic()
        player.terminate()
        rest = player.stderr.read()
        assert player.wait() == 0
    assert time.monotonic() - start_s < 5 * LOAD_FACTOR
    assert "Traceback" not in rest


@pytest.mark.ros
@pytest.mark.parametrize(
    ("name", "kind", "reason"),
    [
        ("", "std_msgs/msg/String", "received '', expected the name of a topic that ROS can use"),
        ("/a//b", "std_msgs/msg/String", "received '/a//b', expected the name of a topic"),
        ("/{x}\x1b[31m", "std_msgs/msg/String", r"received '/{x}\x1b[31m', expected"),
        ("/" + "a" * 100_000, "std_msgs/msg/String", "aaa', expected the name of a topic"),
        ("/text", "../etc/msg/Passwd", "'../etc/msg/Passwd' is no name of a message type"),
        ("/text", "a" * 100_000 + "/msg/B", "is no name of a message type"),
    ],
    ids=["empty", "slashes", "characters", "long_name", "type", "long_type"],
)
def test_a_bag_without_a_topic_that_can_be_played_is_refused_in_a_sentence(
    name: str, kind: str, reason: str, tmp_path: Path, ros_domain_id: int
) -> None:
    file = bag_of_topics(tmp_path, [name], kind)
    _, logged = replay(file, status=2)
    assert f"{file} has no topic that can be played" in logged
    assert reason in logged
    assert "arguments" not in logged
    assert len(logged) < 1000


@pytest.mark.ros
def test_topics_that_cannot_be_played_are_named_and_others_played(
    tmp_path: Path, ros_domain_id: int
) -> None:
    file = bag_of_topics(tmp_path, ["/a b", "/plain"])
    told, logged = replay(file, "--delay", "0.1", status=1)
    assert "'/a b' is not played: bag: received '/a b'" in logged
    assert "/plain: 1 message, no reader" in told


FILL = """
import resource, sys
from pathlib import Path
from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic

resource.setrlimit(resource.RLIMIT_FSIZE, (4_000_000, resource.RLIM_INFINITY))
with BagWriter(Path(sys.argv[1])) as bag:
    bag.add_topic(RecordedTopic("/noise", "std_msgs/msg/String"))
    noise = Path("/dev/urandom").open("rb")
    try:
        while True:
            bag.write("/noise", noise.read(100_000), 1 + bag.message_count, 0)
    except OSError as error:
        print(bag.message_count, error)
"""


def test_a_bag_on_a_full_disk_is_closed_and_opens(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    command = [sys.executable, "-c", FILL, str(folder)]
    told = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout

    count, _, reason = told.partition(" ")
    assert "No space left" in reason or "KB left" in reason
    with AnyReader([folder]) as reader:
        assert int(count) == reader.message_count == sum(1 for _ in reader.messages())
    assert int(count) >= 15  # of 4 MB, two of which are kept free
