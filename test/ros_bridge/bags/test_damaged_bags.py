"""Damaged bags: what can be read is saved, what is lost is told, no reader has a traceback."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import zstandard
from commands import oaisys
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_ros_bridge.bags.info import summary_of
from oaisys_ros_bridge.bags.losses import BagLosses
from oaisys_ros_bridge.bags.mcap_format.mcap_records import LARGEST_CHUNK_BYTES, RecordFile
from oaisys_ros_bridge.bags.reading import BagReader, recover
from oaisys_ros_bridge.bags.recorded.recorded_samples import open_bag
from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic, qos_entry
from oaisys_ros_bridge.experiments.evaluation.bag_perturbations import frames_of_bag

QOS = (qos_entry(depth=5, reliable=True, transient_local=False),)
TOPICS = {
    "/chatter": "std_msgs/msg/String",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/oaisys_bridge/sample_info": "oaisys_msgs/msg/SampleInfo",
    "/camera/depth/image_raw": "sensor_msgs/msg/Image",
}
COUNT = 12
TEXTS = [f"message {i} " + "x" * 40 for i in range(COUNT)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of a whole bag, with `TEXTS` on ``/chatter``."""
    from sensor_msgs.msg import Image

    from oaisys_msgs.msg import SampleInfo

    folder = tmp_path_factory.mktemp("bags") / "whole"
    messages = {
        "/tf": TFMessage(),
        "/oaisys_bridge/sample_info": SampleInfo(),
        "/camera/depth/image_raw": Image(),
    }
    with BagWriter(folder) as bag:
        for name, kind in TOPICS.items():
            bag.add_topic(RecordedTopic(name, kind, QOS))
        for i, text in enumerate(TEXTS):
            bag.write("/chatter", serialize_message(String(data=text)), i * 10, i * 10)
            for name, message in messages.items():
                bag.write(name, serialize_message(message), i * 10 + 1, i * 10 + 1)
        bag.close(BagLosses(announced=3))
    return (folder / "whole_0.mcap").read_bytes()


def chunk_places(data: bytes, tmp_path: Path) -> list[int]:
    """Return where the chunks of a file begin."""
    path = tmp_path / "places.mcap"
    path.write_bytes(data)
    with path.open("rb") as stream:
        return [p.offset for p in RecordFile(stream).places(8) if p.opcode == Opcode.CHUNK]


def chatter_of(folder: Path) -> list[str]:
    with AnyReader([folder]) as reader:
        chosen = [c for c in reader.connections if c.topic == "/chatter"]
        return [reader.deserialize(d, c.msgtype).data for c, _, d in reader.messages(chosen)]


def put(data: bytes, offset: int, new: bytes) -> bytes:
    return data[:offset] + new + data[offset + len(new) :]


CHANGES: dict[str, Callable[[bytes, int], bytes]] = {
    "a flipped byte in its content": lambda d, at: put(d, at + 60, bytes([d[at + 60] ^ 0xFF])),
    "its length 2**40": lambda d, at: put(d, at + 1, struct.pack("<Q", 2**40)),
    "its length as far as the next but one": lambda d, at: put(
        d, at + 1, struct.pack("<Q", int.from_bytes(d[at + 1 : at + 9], "little") + 250)
    ),
    "its length 0": lambda d, at: put(d, at + 1, bytes(8)),
    "its unpacked size 2**40": lambda d, at: put(d, at + 25, struct.pack("<Q", 2**40)),
    "its checksum": lambda d, at: put(d, at + 33, b"\1\2\3\4"),
    "its compression": lambda d, at: put(d, at + 41, b"best"),
    "its compression's length": lambda d, at: put(d, at + 37, struct.pack("<I", 2**31)),
    "its kind": lambda d, at: put(d, at, b"\x77"),
    "zeros over its beginning": lambda d, at: put(d, at, bytes(40)),
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_damaged_chunk_is_skipped_and_the_others_are_saved(
    whole: bytes, tmp_path: Path, what: str
) -> None:
    """Recovery ended there, and all that followed was lost without a word."""
    place = chunk_places(whole, tmp_path)[4 * 4]  # the fifth message of /chatter
    file = tmp_path / "damaged.mcap"
    file.write_bytes(CHANGES[what](whole, place))
    told: list[str] = []

    copied = recover(file, tmp_path / "saved", told.append)

    assert copied == 4 * COUNT - 1
    assert chatter_of(tmp_path / "saved") == TEXTS[:4] + TEXTS[5:]
    assert any(
        f"its index counts {4 * COUNT} messages, {4 * COUNT - 1} could be" in t for t in told
    )
    with pytest.raises(InvalidInputError, match="oaisys bag recover"):
        list(BagReader(file).messages(["/chatter"]))


def test_lost_messages_are_counted_by_topic(whole: bytes, tmp_path: Path) -> None:
    data = whole
    for place in chunk_places(whole, tmp_path)[0:12:4]:
        data = CHANGES["its checksum"](data, place)
    file = tmp_path / "damaged.mcap"
    file.write_bytes(data[:-300])  # without a summary
    done = oaisys("bag", "recover", file, "--out", tmp_path / "saved")
    assert done.returncode == 0, done.stderr
    assert f"{4 * COUNT - 3} messages" in done.stdout
    lost = [line for line in done.stderr.splitlines() if line.startswith("lost: ")]
    assert "lost: /chatter: 3 messages lost" in lost
    assert any("the checksum of a chunk is wrong" in line and "3 parts" in line for line in lost)


def test_a_damaged_description_is_taken_from_the_summary(whole: bytes, tmp_path: Path) -> None:
    file = tmp_path / "damaged.mcap"
    at = whole.index(b"/chatter")
    file.write_bytes(put(whole, at, b"/zzzzzzz"))
    assert recover(file, tmp_path / "saved") == 4 * COUNT
    assert chatter_of(tmp_path / "saved") == TEXTS


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_bags_of_other_recorders_are_read_and_recovered(
    tmp_path: Path, compression: CompressionType, chunked: bool
) -> None:
    file = tmp_path / "other.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, compression=compression, use_chunking=chunked, chunk_size=300)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        for i in (1, 0, *range(2, COUNT)):
            writer.add_message(channel, i, serialize_message(String(data=TEXTS[i])), i)
        writer.finish()
    read = [m.deserialize(String).data for m in BagReader(file).messages(["/chatter"])]
    assert read == TEXTS
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: -len(file.read_bytes()) // 4])
    assert 0 < recover(cut, tmp_path / "saved") <= COUNT


def chunk(records: bytes, size: int | None = None, packed: bytes | None = None) -> bytes:
    packed = zstandard.compress(records) if packed is None else packed
    head = struct.pack("<QQQI", 0, 0, len(records) if size is None else size, zlib.crc32(records))
    content = head + struct.pack("<I4sQ", 4, b"zstd", len(packed)) + packed
    return struct.pack("<BQ", Opcode.CHUNK, len(content)) + content


def test_chunks_that_are_bombs_or_nested_are_skipped(whole: bytes, tmp_path: Path) -> None:
    """A kilobyte of zstd holds gigabytes; a chunk in a chunk has no end."""
    first = chunk_places(whole, tmp_path)[0]
    zeros = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    bomb = b"".join(zeros.compress(bytes(2**24)) for _ in range(40)) + zeros.flush()
    attacks = [
        chunk(b"", size=LARGEST_CHUNK_BYTES + 1, packed=bomb),
        chunk(b"", size=1000, packed=bomb),
        chunk(chunk(chunk(b""))),
        chunk(struct.pack("<BQ", Opcode.MESSAGE, 2**40)),
    ]
    file = tmp_path / "attack.mcap"
    file.write_bytes(whole[:first] + b"".join(attacks) + whole[first:])
    told: list[str] = []
    assert recover(file, tmp_path / "saved", told.append) == 4 * COUNT
    assert sum("parts skipped" in sentence for sentence in told) == len(attacks)


READERS: dict[str, Callable[[Path], object]] = {
    "info": summary_of,
    "replay": lambda path: [list(b.messages(b.topics)) for b in [BagReader(path)]],
    "repeat": lambda path: [list(s.read(s.ids())) for s in [open_bag(path)] if s],
    "evaluation": lambda path: list(frames_of_bag(path)),
}


def mutations(data: bytes, number: int) -> Iterator[bytes]:
    """Yield damaged copies: bytes flipped, cut out, cut off, doubled, lengths made huge."""
    drawn = random.Random(34)
    for _ in range(number):
        copy = bytearray(data)
        for _ in range(drawn.choice((1, 1, 3, 10))):
            at = drawn.randrange(len(copy))
            kind = drawn.randrange(6)
            if kind == 0:
                copy[at] ^= 1 << drawn.randrange(8)
            elif kind == 1:
                copy[at : at + 8] = struct.pack("<Q", drawn.choice((0, 2**31, 2**40, 2**64 - 1)))
            elif kind == 2:
                del copy[at : at + drawn.choice((1, 9, 200))]
            elif kind == 3:
                del copy[max(at, 1) :]
            elif kind == 4:
                copy[at:at] = copy[at : at + drawn.choice((1, 40, 400))]
            else:
                copy[at : at + 30] = drawn.randbytes(30)
        yield bytes(copy)


@pytest.mark.parametrize("reader", READERS)
def test_no_reader_of_a_mutated_bag_fails_but_with_a_sentence(
    whole: bytes, tmp_path: Path, reader: str
) -> None:
    file = tmp_path / "mutated.mcap"
    for data in mutations(whole, 100):
        file.write_bytes(data)
        with suppress(OaisysError):  # any other error fails the test
            READERS[reader](file)


def test_recovery_of_mutated_bags_ends_in_bags_that_others_read(
    whole: bytes, tmp_path: Path
) -> None:
    file = tmp_path / "mutated.mcap"
    for number, data in enumerate(mutations(whole, 60)):
        file.write_bytes(data)
        saved = tmp_path / f"saved{number}"
        try:
            copied = recover(file, saved)
        except InvalidInputError:
            assert not saved.exists()
            continue
        with next(saved.glob("*.mcap")).open("rb") as stream:
            assert len(list(make_reader(stream, validate_crcs=True).iter_messages())) == copied


def test_commands_tell_of_damage_in_a_sentence(whole: bytes, tmp_path: Path) -> None:
    file = tmp_path / "damaged.mcap"
    file.write_bytes(put(whole, len(whole) - 60, b"\xff" * 8))
    for arguments in (["info", file], ["replay", file, "--delay", "0.1"]):
        done = oaisys("bag", *arguments)
        assert done.returncode == 2, done.stderr
        assert "oaisys bag recover" in " ".join(done.stderr.split())
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize("name", ["../outside.mcap", "/etc/passwd", "bag/../x.mcap", ""])
def test_a_bag_s_list_of_files_names_files_in_it_alone(
    whole: bytes, tmp_path: Path, name: str
) -> None:
    (tmp_path / "outside.mcap").write_bytes(whole)
    (tmp_path / "bag").mkdir()
    listing = f'rosbag2_bagfile_information: {{relative_file_paths: ["{name}"]}}'
    (tmp_path / "bag" / "metadata.yaml").write_text(listing)
    with pytest.raises(InvalidInputError, match="bag"):
        BagReader(tmp_path / "bag")
