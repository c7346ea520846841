"""Reads rosbag2 MCAP bags: of our recorder, and of ``ros2 bag record``."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.summary import Summary

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_ros_bridge.bags.info import FINISHED
from oaisys_ros_bridge.bags.writing import METADATA_FILE, RecordedTopic


@dataclass(frozen=True)
class RecordedMessage:
    """One message as it was recorded.

    Attributes:
        data: CDR, with its header.
        received_ns: When it was.
    """

    topic: str
    data: bytes
    received_ns: int


class BagReader:
    """A finished bag of one file or several.

    Args:
        path: The bag's folder, or one file of it.

    Raises:
        InvalidInputError: It is none, or is cut short.
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


def _files_of(path: Path) -> Sequence[Path]:
    """Return the files of a bag in their order."""
    listing = path / METADATA_FILE
    if listing.is_file():
        try:
            known = yaml.safe_load(listing.read_text(encoding="utf-8"))
            names = known["rosbag2_bagfile_information"]["relative_file_paths"]
            files = [path / str(name) for name in names]
        except (yaml.YAMLError, KeyError, TypeError) as error:
            raise InvalidInputError(
                "bag", str(listing), "rosbag2's description of a bag"
            ) from error
    else:
        files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise InvalidInputError("bag", str(path), "a folder with .mcap files, or such a file")
    return files


def _topics_of(file: Path) -> Iterator[RecordedTopic]:
    with file.open("rb") as stream:
        summary = _summary_of(file, make_reader(stream))
    for channel in summary.channels.values():
        if channel.message_encoding != "cdr":
            raise InvalidInputError("bag", str(file), "messages in CDR, as ROS 2 has them")
        profiles = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or ()
        type_name = summary.schemas[channel.schema_id].name
        yield RecordedTopic(channel.topic, type_name, tuple(profiles))


def _summary_of(file: Path, reader: McapReader) -> Summary:
    try:
        summary = reader.get_summary()
    except (McapError, struct.error) as error:  # where there is no footer it reads anything
        raise InvalidInputError("bag", str(file), FINISHED) from error
    if summary is None:
        raise InvalidInputError("bag", str(file), FINISHED)
    return summary


RELIABLE = ("reliable", 1)
TRANSIENT_LOCAL = ("transient_local", 1)
"""As bags name them: Jazzy by name, distributions before it by number."""


@dataclass(frozen=True)
class OfferedQos:
    """With what quality of service a topic was published, by all of its publishers.

    Attributes:
        depth: Of the deepest queue; 0: unknown.
    """

    depth: int
    reliable: bool
    transient_local: bool


def offered_qos(profiles: Sequence[Mapping[str, Any]]) -> OfferedQos:
    """Return what all publishers of a topic offered."""
    depth = max((int(profile.get("depth", 0)) for profile in profiles), default=0)
    latched = bool(profiles) and all(p.get("durability") in TRANSIENT_LOCAL for p in profiles)
    return OfferedQos(
        # One publisher stands for all of them, each of which kept its last messages.
        depth=depth * len(profiles) if latched else depth,
        reliable=all(profile.get("reliability") in RELIABLE for profile in profiles),
        transient_local=latched,
    )
