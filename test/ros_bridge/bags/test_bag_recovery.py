"""Bags that were cut short."""

from pathlib import Path

import pytest
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.bags.info import summary_of
from oaisys_ros_bridge.bags.reading import recover
from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic, qos_entry

TOPIC = RecordedTopic(
    "/chatter",
    "std_msgs/msg/String",
    (qos_entry(depth=5, reliable=True, transient_local=False),),
)
TEXTS = [f"message {i} " + "x" * 100 for i in range(10)]


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Return the file of a whole bag with `TEXTS`, a second apart."""
    folder = tmp_path / "whole"
    with BagWriter(folder) as bag:
        bag.add_topic(TOPIC)
        for i, text in enumerate(TEXTS):
            data = serialize_message(String(data=text))
            bag.write(TOPIC.name, data, received_ns=(i + 1) * 10**9, published_ns=i * 10**9)
    (file,) = folder.glob("*.mcap")
    return file


def chunk_ends(file: Path) -> list[int]:
    """Return where each message's chunk ends in the file."""
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunks = [(c.chunk_start_offset, c.chunk_length) for c in summary.chunk_indexes]
    return sorted(start + length for start, length in chunks)


@pytest.mark.parametrize(("beyond_bytes", "kept"), [(0, 7), (1, 7), (40, 7), (-1, 6)])
def test_every_whole_message_before_the_cut_is_saved(recorded, tmp_path, beyond_bytes, kept):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.read_bytes()[: chunk_ends(recorded)[6] + beyond_bytes])

    assert recover(cut, tmp_path / "saved") == kept

    with AnyReader([tmp_path / "saved"]) as reader:
        (connection,) = reader.connections
        assert (connection.topic, connection.msgtype) == (TOPIC.name, TOPIC.type_name)
        assert connection.msgcount == kept
        messages = list(reader.messages())
    texts = [deserialize_message(data, String).data for _, _, data in messages]
    assert texts == TEXTS[:kept]
    assert [time_ns for _, time_ns, _ in messages] == [(i + 1) * 10**9 for i in range(kept)]


def test_a_cut_bag_has_no_summary_and_says_what_helps(recorded, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recorded.read_bytes()[:-100])

    with pytest.raises(InvalidInputError, match="oaisys bag recover"):
        summary_of(cut)
    recover(cut, tmp_path / "saved")

    total, line = summary_of(tmp_path / "saved")
    assert "10 messages, 9.0 s" in total
    assert line.split() == ["/chatter", "std_msgs/msg/String", "10"]


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"something else entirely"])
def test_a_file_without_messages_is_refused_and_leaves_nothing(tmp_path, content):
    file = tmp_path / "file.mcap"
    file.write_bytes(content)

    with pytest.raises(InvalidInputError, match="at least one message"):
        recover(file, tmp_path / "saved")

    assert not (tmp_path / "saved").exists()
