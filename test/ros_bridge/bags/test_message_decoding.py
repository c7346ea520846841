"""Definitions of messages in bags, as anybody may have written them."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import pytest
from mcap.records import Schema
from mcap.writer import CompressionType, Writer
from waiting import LOAD_FACTOR

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses import read_pose_table
from oaisys_ros_bridge.bags.mcap_format.message_decoding import (
    MAX_DEFINITION_BYTES,
    MAX_FIELDS,
    decoder_of,
)
from oaisys_ros_bridge.bags.mcap_format.message_definition import SEPARATOR, message_definition
from oaisys_ros_bridge.bags.reading import BagReader

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE = message_definition(POSE_STAMPED)
DATA = b"\0\1\0\0" + struct.pack("<iII4s7d", 1, 0, 4, b"map\0", 1, 2, 3, 0, 0, 0, 1)
REFUSED_WITHIN_S = 1.0


def schema(definition: str) -> Schema:
    return Schema(id=1, name="some_msgs/msg/Some", encoding="ros2msg", data=definition.encode())


def bag(path: Path, definition: str) -> Path:
    """Write a bag with one pose, whose type is described like this."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        described = writer.register_schema(POSE_STAMPED, "ros2msg", definition.encode())
        writer.add_message(writer.register_channel("/pose", "cdr", described), 1, DATA, 1)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("definition", "expected"),
    [
        ("\n".join(f"float64 x{i}" for i in range(300_000)), f"at most {MAX_DEFINITION_BYTES} b"),
        ("\n".join(f"float64 x{i}" for i in range(20_000)), f"at most {MAX_FIELDS} fields"),
        ("# note\n" * MAX_DEFINITION_BYTES, f"at most {MAX_DEFINITION_BYTES} bytes"),
        (f"float64 {'x' * 100_000}", "a field of a message"),
        ("float64 x y\x1b[31m\nfloat64 X", "a field of a message"),
        ("int32[999999999999999999] x", "a field of a message"),
        ("uint8[0] x", "a field of a message"),
        ("bad__package/Type x", "a type that can be decoded"),
        (f"float64 x\n{SEPARATOR}\nMSG: some_msgs/a_b_\nfloat64 y", "a type that can be decoded"),
    ],
    ids=["bytes", "fields", "comments", "name", "characters", "size", "none", "package", "type"],
)
def test_a_definition_that_is_too_large_or_wrong_is_refused_at_once(
    definition: str, expected: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    start_s = time.monotonic()
    file = bag(tmp_path / "bag.mcap", definition)
    with pytest.raises(InvalidInputError, match=expected) as raised:
        read_pose_table(file)
    assert time.monotonic() - start_s < REFUSED_WITHIN_S * LOAD_FACTOR
    text = f"{raised.value}{capfd.readouterr().err}"
    assert len(text) < 1000
    assert "the type of /pose" in text
    assert "\x1b" not in text


@pytest.mark.parametrize(
    "line",
    [
        f"int32 X={'9' * 400}",
        f"int32 {'A' * 60}_=1",
        "uint8 HUGE = 256",
        'string TEXT="a=b # c"',
    ],
    ids=["large", "name", "range", "text"],
)
def test_constants_of_any_value_change_nothing(line: str, tmp_path: Path) -> None:
    """The parser raised errors of its own, or took exponential time."""
    table = read_pose_table(bag(tmp_path / "bag.mcap", f"{line}\n{POSE}"))
    assert table.positions_m.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    "default", ["[1, 2, __import__('os')]", "[" * 500, '"a=b"', "9" * 400], ids=range(4)
)
def test_defaults_of_any_value_change_nothing(default: str) -> None:
    decode = decoder_of("cdr", schema(f"int32[] x {default}\nfloat32 y 1.5"), "a type")
    assert decode is not None
    found = decode(b"\0\1\0\0" + struct.pack("<Iif", 1, 7, 2.5))
    assert (list(found.x), found.y) == ([7], 2.5)


@pytest.mark.parametrize("size", ["", "999999999"], ids=["announced", "fixed"])
def test_elements_without_a_byte_are_refused_at_once(size: str) -> None:
    nested = f"some_msgs/E[{size}] x\n{SEPARATOR}\nMSG: some_msgs/E\nuint8[3] y"
    decode = decoder_of("cdr", schema(nested), "a type")
    assert decode is not None
    start_s = time.monotonic()
    with pytest.raises(ValueError, match="it ends after 9 bytes"):
        decode(b"\0\1\0\0" + (10**9).to_bytes(4, "little") + b"\1")
    assert time.monotonic() - start_s < REFUSED_WITHIN_S * LOAD_FACTOR


def test_a_message_of_an_earlier_type_is_refused_by_its_topic(tmp_path: Path) -> None:
    from nav_msgs.msg import Odometry

    described = "\n".join(f"float64 x{i}" for i in range(MAX_FIELDS + 1))
    (message,) = BagReader(bag(tmp_path / "bag.mcap", described)).messages(["/pose"])
    with pytest.raises(InvalidInputError, match=r"/pose: .* a message of the type Odometry"):
        message.deserialize(Odometry)


def test_other_encodings_have_no_decoder() -> None:
    assert decoder_of("json", schema("float64 x"), "a type") is None
    assert decoder_of("cdr", None, "a type") is None
