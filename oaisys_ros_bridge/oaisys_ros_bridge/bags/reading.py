"""Reads rosbag2 MCAP bags of any recorder, and recovers those that were cut short."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Schema

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_core.files.documents import read_text
from oaisys_core.files.yaml_documents import parse_yaml
from oaisys_ros_bridge.bags.mcap_format.finished_bag import describe_topic, open_finished
from oaisys_ros_bridge.bags.mcap_format.mcap_records import RecordFile, list_names, printable
from oaisys_ros_bridge.bags.mcap_format.salvage import salvage
from oaisys_ros_bridge.bags.writing import METADATA_FILE, RecordedTopic

RELIABLE = ("reliable", 1)
TRANSIENT_LOCAL = ("transient_local", 1)
"""Values in bags: names since Jazzy, numbers before."""


@dataclass(frozen=True)
class RecordedMessage:
    """A recorded message.

    Attributes:
        topic: Its full name.
        data: In CDR, with its header.
        received_ns: When the recorder received it.
        schema: Describes its type as it was then; None: unknown.
    """

    topic: str
    data: bytes
    received_ns: int
    schema: Schema | None = None

    def deserialize(self, kind: type[Any]) -> Any:
        """Return the message, whose type is ``kind``; what the type did not have yet is empty.

        Raises:
            InvalidInputError: Its bytes are not such a message.
        """
        from rclpy.serialization import deserialize_message  # not all readers need ROS

        try:
            return deserialize_message(self.data, kind)
        except (RuntimeError, ValueError, MemoryError) as error:
            earlier = self._deserialize_earlier(kind)
            if earlier is not None:
                return earlier
            expected = f"a message of the type {kind.__name__}"
            raise InvalidInputError(self.topic, self.data[:40], expected) from error

    def _deserialize_earlier(self, kind: type[Any]) -> Any:
        """Return the message by the bag's own description of its type; None: it is no such one."""
        from oaisys_ros_bridge.bags.mcap_format.earlier_types import decode_earlier  # needs ROS

        return None if self.schema is None else decode_earlier(self.data, self.schema, kind)


class BagReader:
    """A finished bag of one file or several.

    Args:
        path: The bag's folder, or one file of it.

    Raises:
        InvalidInputError: There is no bag, or it is cut short.
    """

    def __init__(self, path: Path) -> None:
        self._files = files_of_bag(path)
        self.topics: Mapping[str, RecordedTopic] = {
            topic.name: topic for file in self._files for topic in _topics_of(file)
        }

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]:
        """Yield the messages of some topics in the order in which they were received.

        Raises:
            InvalidInputError: The bag is damaged where they are.
        """
        for file in self._files:
            with open_finished(file) as (reader, _):
                for schema, channel, message in reader.iter_messages(topics):
                    yield RecordedMessage(channel.topic, message.data, message.log_time, schema)

    def require(self, topics: Collection[str]) -> None:
        """Raise `NotFoundError` where the bag does not have all of these topics."""
        missing = sorted(set(topics) - self.topics.keys())
        if missing:
            raise NotFoundError(
                f"the bag has no topic {printable(missing[0])}, but {list_names(self.topics)}"
            )


def mcap_file(path: Path) -> Path:
    """Return a bag's one file, given that or its folder; `InvalidInputError` if there is none."""
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if len(files) != 1 or not files[0].is_file():
        raise InvalidInputError("bag", str(path), "a folder with one .mcap file, or that file")
    return files[0]


def files_of_bag(path: Path) -> Sequence[Path]:
    """Return the files of a bag in their order."""
    listing = path / METADATA_FILE
    if listing.is_file():
        try:
            metadata = parse_yaml(read_text(listing))
            names = metadata["rosbag2_bagfile_information"]["relative_file_paths"]
            if any(Path(str(name)).name != name for name in names):
                raise ValueError("names of files beside it are expected")
            files = [path / name for name in names]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InvalidInputError(
                "bag", str(listing), "rosbag2's description of a bag"
            ) from error
    else:
        files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise InvalidInputError("bag", str(path), "a folder with .mcap files, or such a file")
    return files


def _topics_of(file: Path) -> Iterator[RecordedTopic]:
    with open_finished(file) as (_, summary):
        for channel in summary.channels.values():
            if channel.message_encoding != "cdr":
                raise InvalidInputError("bag", str(file), "messages in CDR, as ROS 2 has them")
            yield describe_topic(summary.schemas[channel.schema_id], channel)


@dataclass(frozen=True)
class OfferedQos:
    """The quality of service that all publishers of a topic offered.

    Attributes:
        depth: Of the deepest queue; 0: unknown.
    """

    depth: int
    reliable: bool
    transient_local: bool


def topic_qos(profiles: Sequence[Mapping[str, Any]]) -> OfferedQos:
    """Return what all publishers of a topic offered, from the profiles in a bag."""
    depth = max((int(profile.get("depth", 0)) for profile in profiles), default=0)
    latched = bool(profiles) and all(p.get("durability") in TRANSIENT_LOCAL for p in profiles)
    return OfferedQos(
        # The player's one publisher keeps the last messages of all the recorded ones.
        depth=depth * len(profiles) if latched else depth,
        reliable=all(profile.get("reliability") in RELIABLE for profile in profiles),
        transient_local=latched,
    )


def recover(file: Path, out: Path, say: Callable[[str], None] = lambda _: None) -> int:
    """Copy all messages that can be read of a bag's file to a new bag; return their number.

    Damaged parts are skipped; a chunk whose checksum is wrong is such a part.

    Args:
        file: An ``.mcap`` file that may end anywhere, and be damaged anywhere.
        out: Folder of the new bag.
        say: Told what was lost, a sentence at a time.

    Raises:
        InvalidInputError: No message can be read, or ``out`` is not empty.
    """
    told: list[str] = []
    with file.open("rb") as stream:
        copied = salvage(RecordFile(stream), out, told.append)
    if not copied:
        why = f" ({'; '.join(told)})" if told else ""
        raise InvalidInputError("bag", str(file), f"an MCAP file with at least one message{why}")
    for sentence in told:
        say(sentence)
    return copied
