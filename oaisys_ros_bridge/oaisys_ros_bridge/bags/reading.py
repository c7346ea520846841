"""Reads rosbag2 MCAP bags of any recorder, and recovers those that were cut short."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Any

from mcap.exceptions import McapError
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Channel, Message, Schema
from mcap.summary import Summary

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_core.files.documents import parse_yaml, read_text
from oaisys_ros_bridge.bags.writing import METADATA_FILE, BagWriter, RecordedTopic

FINISHED = "a finished MCAP file; `oaisys bag recover` saves what one holds that was cut short"

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
    """

    topic: str
    data: bytes
    received_ns: int


class BagReader:
    """A finished bag of one file or several.

    Args:
        path: The bag's folder, or one file of it.

    Raises:
        InvalidInputError: There is no bag, or it is cut short.
    """

    def __init__(self, path: Path) -> None:
        self._files = _files_of(path)
        self.topics: Mapping[str, RecordedTopic] = {
            topic.name: topic for file in self._files for topic in _topics_of(file)
        }

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]:
        """Yield the messages of some topics in the order in which they were received."""
        for file in self._files:
            with file.open("rb") as stream:
                for _, channel, message in make_reader(stream).iter_messages(topics=list(topics)):
                    yield RecordedMessage(channel.topic, message.data, message.log_time)

    def require(self, topics: Collection[str]) -> None:
        """Raise `NotFoundError` where the bag does not have all of these topics."""
        missing = sorted(set(topics) - self.topics.keys())
        if missing:
            raise NotFoundError(
                f"the bag has no topic {missing[0]}, but {', '.join(sorted(self.topics))}"
            )


@contextmanager
def finished_file(file: Path) -> Iterator[tuple[McapReader, Summary]]:
    """Open an MCAP file; yield a reader and the file's summary.

    Raises:
        InvalidInputError: It is not a finished MCAP file.
    """
    try:
        with file.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            if summary is None:
                raise InvalidInputError("bag", str(file), FINISHED)
            yield reader, summary
    except (McapError, struct.error) as error:  # without a footer `mcap` unpacks other bytes
        raise InvalidInputError("bag", str(file), FINISHED) from error


def mcap_file(path: Path) -> Path:
    """Return a bag's one file, given that or its folder; `InvalidInputError` if there is none."""
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if len(files) != 1 or not files[0].is_file():
        raise InvalidInputError("bag", str(path), "a folder with one .mcap file, or that file")
    return files[0]


def _files_of(path: Path) -> Sequence[Path]:
    """Return the files of a bag in their order."""
    listing = path / METADATA_FILE
    if listing.is_file():
        try:
            metadata = parse_yaml(read_text(listing))
            names = metadata["rosbag2_bagfile_information"]["relative_file_paths"]
            files = [path / str(name) for name in names]
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
    with finished_file(file) as (_, summary):
        for channel in summary.channels.values():
            if channel.message_encoding != "cdr":
                raise InvalidInputError("bag", str(file), "messages in CDR, as ROS 2 has them")
            yield _recorded_topic(summary.schemas[channel.schema_id], channel)


def _recorded_topic(schema: Schema, channel: Channel) -> RecordedTopic:
    profiles = parse_yaml(channel.metadata.get("offered_qos_profiles", "")) or ()
    return RecordedTopic(channel.topic, schema.name, tuple(profiles))


@dataclass(frozen=True)
class OfferedQos:
    """The quality of service that all publishers of a topic offered.

    Attributes:
        depth: Of the deepest queue; 0: unknown.
    """

    depth: int
    reliable: bool
    transient_local: bool


def offered_qos(profiles: Sequence[Mapping[str, Any]]) -> OfferedQos:
    """Return what all publishers of a topic offered, from the profiles in a bag."""
    depth = max((int(profile.get("depth", 0)) for profile in profiles), default=0)
    latched = bool(profiles) and all(p.get("durability") in TRANSIENT_LOCAL for p in profiles)
    return OfferedQos(
        # The player's one publisher keeps the last messages of all the recorded ones.
        depth=depth * len(profiles) if latched else depth,
        reliable=all(profile.get("reliability") in RELIABLE for profile in profiles),
        transient_local=latched,
    )


def recover(file: Path, out: Path) -> int:
    """Copy all complete messages of a bag's file to a new bag and return their number.

    Args:
        file: An ``.mcap`` file that may end anywhere.
        out: Folder of the new bag.

    Raises:
        InvalidInputError: ``file`` holds no complete message, or ``out`` is not empty.
        NotFoundError: The type of a topic is not installed here.
    """
    with file.open("rb") as stream:
        messages = _complete_messages(stream)
        first = next(messages, None)
        if first is None:
            raise InvalidInputError("bag", str(file), "an MCAP file with at least one message")
        with BagWriter(out) as bag:
            for schema, channel, message in chain([first], messages):
                bag.add_topic(_recorded_topic(schema, channel))
                bag.write(channel.topic, message.data, message.log_time, message.publish_time)
            return bag.message_count


def _complete_messages(stream: IO[bytes]) -> Iterator[tuple[Schema, Channel, Message]]:
    """Yield messages in the file's order, up to its end or to where it cannot be read."""
    try:
        for schema, channel, message in NonSeekingReader(stream).iter_messages(
            log_time_order=False
        ):
            if schema is not None:
                yield schema, channel, message
    except (McapError, struct.error):  # the latter from a record that was cut
        return
