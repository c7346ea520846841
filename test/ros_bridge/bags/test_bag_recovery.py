"""Bags that were cut short."""

from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.bags.info import losses_of, summary_of
from oaisys_ros_bridge.bags.losses import METADATA_NAME, BagLosses
from oaisys_ros_bridge.bags.mcap_format.salvage import MAX_METADATA_BYTES
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


LOSSES = BagLosses(5, 2, {"/chatter": 2}, {"/tf": 3}, {"/chatter": 1})


def with_records(folder: Path, *records: tuple[str, dict[str, str]], attach: bool = False) -> Path:
    """Write a bag with a message and metadata records, without an end."""
    file = folder / "open.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema(TOPIC.type_name, "ros2msg", b"string data")
        channel = writer.register_channel(TOPIC.name, "cdr", schema)
        writer.add_message(channel, 1, serialize_message(String(data="text")), 1)
        for name, entries in records:
            writer.add_metadata(name, entries)
        if attach:
            writer.add_attachment(1, 1, "notes.txt", "text/plain", b"notes")
        writer.finish()
    return file


def test_what_the_recorder_lost_and_other_metadata_are_kept(tmp_path: Path) -> None:
    weather = ("weather", {"wind": "2 m/s", "note": "a\nb: c"})
    old = ("rosbag2", {"serialized_metadata": "of the old file"})
    file = with_records(tmp_path, weather, (METADATA_NAME, LOSSES.entries), old, attach=True)
    told: list[str] = []
    assert recover(file, tmp_path / "saved", told.append) == 1
    assert told == ["attachments are left out: 1"]
    assert losses_of(tmp_path / "saved") == LOSSES
    assert summary_of(tmp_path / "saved")[-len(LOSSES.sentences) :] == [
        f"  {sentence}" for sentence in LOSSES.sentences
    ]
    with next((tmp_path / "saved").glob("*.mcap")).open("rb") as stream:
        found = {each.name: each.metadata for each in make_reader(stream).iter_metadata()}
    assert found.keys() == {"weather", METADATA_NAME, "rosbag2"}
    assert found["weather"] == weather[1]
    assert "of the old file" not in found["rosbag2"]["serialized_metadata"]
    listed = yaml.safe_load((tmp_path / "saved" / "metadata.yaml").read_text())
    assert listed["rosbag2_bagfile_information"]["custom_data"] == LOSSES.entries


def test_metadata_that_cannot_be_kept_is_told(tmp_path: Path) -> None:
    large = {"text": "x" * MAX_METADATA_BYTES}
    file = with_records(tmp_path, (METADATA_NAME, {"oaisys.samples": "-1"}), ("large", large))
    told: list[str] = []
    assert recover(file, tmp_path / "saved", told.append) == 1
    assert "its record of what was lost cannot be read: oaisys.samples: received '-1'" in told[0]
    assert told[1:] == ["metadata records beyond 16 MB are left out: 1"]
    assert losses_of(tmp_path / "saved") is None


@pytest.mark.parametrize(
    ("name", "kind"),
    [("/" + "a" * 100_000, "std_msgs/msg/Missing"), ("/text", "std_msgs/msg/A" + "a" * 100_000)],
    ids=["topic", "type"],
)
def test_names_of_any_length_are_told_shortened(name: str, kind: str, tmp_path: Path) -> None:
    file = tmp_path / "names.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        channel = writer.register_channel(
            name, "cdr", writer.register_schema(kind, "ros2msg", b"string data")
        )
        writer.add_message(channel, 1, serialize_message(String(data="text")), 1)
        writer.finish()
    with pytest.raises(InvalidInputError, match=r"no definition of|no name of") as raised:
        recover(file, tmp_path / "saved")
    assert "aaa..." in str(raised.value) or "...aaa" in str(raised.value)
    assert len(str(raised.value)) < 600
