"""Writes rosbag2 bags in the MCAP format, without rosbag2.

Each message is in the file when `BagWriter.write` returns. The summary and ``metadata.yaml`` are
written at the end (rosbag2's format version 9; MCAP's registry: profile ``ros2``, schema encoding
``ros2msg``, message encoding ``cdr``).
"""

from __future__ import annotations

import errno
import resource
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import yaml

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_ros_bridge.bags.losses import METADATA_NAME, BagLosses
from oaisys_ros_bridge.bags.mcap_format.mcap_writer import McapWriter
from oaisys_ros_bridge.bags.mcap_format.message_definition import message_definition, type_hash

METADATA_FILE = "metadata.yaml"
METADATA_VERSION = 9
ROSBAG2_NAME = "rosbag2"
"""Name of the metadata record that repeats ``metadata.yaml``."""

SPARE_BYTES = 2 * 2**20
"""Free space that is kept, in addition to the summary's size, to close the bag."""


@dataclass(frozen=True)
class RecordedTopic:
    """A topic of a bag.

    Attributes:
        name: Its full name.
        type_name: Such as ``sensor_msgs/msg/Image``.
        qos_profiles: What its publishers offered, as `qos_entry` gives it.
    """

    name: str
    type_name: str
    qos_profiles: tuple[dict[str, Any], ...] = field(default=(), compare=False)


def qos_entry(*, depth: int, reliable: bool, transient_local: bool) -> dict[str, Any]:
    """Return a quality of service without deadlines as rosbag2 writes it; depth 0: unknown."""
    unlimited = {"sec": 9223372036, "nsec": 854775807}
    return {
        "history": "keep_last" if depth else "unknown",
        "depth": depth,
        "reliability": "reliable" if reliable else "best_effort",
        "durability": "transient_local" if transient_local else "volatile",
        "deadline": dict(unlimited),
        "lifespan": dict(unlimited),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(unlimited),
        "avoid_ros_namespace_conventions": False,
    }


@dataclass(frozen=True)
class BagContents:
    """The contents of a bag's one file.

    Attributes:
        file_name: Within the bag's folder.
        counts: Messages by topic.
        first_ns, last_ns: When the first and the last one were received; 0 if there is none.
    """

    file_name: str
    counts: Mapping[RecordedTopic, int]
    first_ns: int
    last_ns: int


class BagWriter:
    """Writes a bag; a context manager.

    Args:
        folder: The bag; made here. It must not exist, or be empty.
        distribution: Name of the ROS distribution that wrote it.

    Raises:
        InvalidInputError: The folder is not empty.
        OSError: The folder cannot be written.
    """

    def __init__(self, folder: Path, distribution: str = "jazzy") -> None:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InvalidInputError("path", str(folder), "a folder that is new or empty")
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._distribution = distribution
        self._topics: dict[str, tuple[RecordedTopic, int]] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._losses: Mapping[str, str] | None = None
        self._file = McapWriter(folder / f"{folder.resolve().name}_0.mcap", profile="ros2")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(self._counts.values())

    @property
    def is_there(self) -> bool:
        """Whether what was written is where it was written to."""
        return self._file.path.is_file()

    def add_topic(self, topic: RecordedTopic) -> None:
        """Add a topic, once.

        Raises:
            NotFoundError: Its type is not installed here.
            OSError: It cannot be written.
        """
        if topic.name in self._topics:
            return
        if topic.type_name not in self._schemas:
            definition = message_definition(topic.type_name).encode()
            schema = self._file.add_schema(topic.type_name, "ros2msg", definition)
            self._schemas[topic.type_name] = schema
        channel = self._file.add_channel(
            topic.name,
            self._schemas[topic.type_name],
            {
                "offered_qos_profiles": yaml.safe_dump(list(topic.qos_profiles)),
                "topic_type_hash": type_hash(topic.type_name),
            },
        )
        self._topics[topic.name] = (topic, channel)
        self._counts[topic.name] = 0

    def write(self, topic: str, data: bytes, received_ns: int, published_ns: int) -> None:
        """Write a serialised message (CDR with its header).

        Raises:
            NotFoundError: The topic was not added.
            OSError: It cannot be written, or there would be no room left to close the bag; or its
                file was deleted, moved, replaced or cut.
        """
        if topic not in self._topics:
            raise NotFoundError(f"the bag has no topic {topic}")
        self._file.require_whole()
        self._require_room(len(data))
        _, channel = self._topics[topic]
        self._file.add_message(channel, received_ns, data, published_ns)
        self._counts[topic] += 1
        if self._first_ns is None or received_ns < self._first_ns:
            self._first_ns = received_ns
        self._last_ns = max(self._last_ns, received_ns)

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write a metadata record; that of losses goes into ``metadata.yaml``, too.

        Raises:
            OSError: It cannot be written.
        """
        self._file.add_metadata(name, entries)
        if name == METADATA_NAME:
            self._losses = dict(entries)

    def _require_room(self, length: int) -> None:
        """Raise `OSError` where the disk has no room for a message and, later, the summary."""
        room = shutil.disk_usage(self._folder).free
        largest, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
        if largest != resource.RLIM_INFINITY:
            room = min(room, largest - self._file.length)
        if room < length + self._file.summary_length + SPARE_BYTES:
            raise OSError(errno.ENOSPC, f"{room >> 10} KB left", str(self._file.path))

    def close(self, losses: BagLosses | None = None) -> None:
        """Write the summary and ``metadata.yaml``; a second call does nothing.

        Args:
            losses: What the recorder has lost; None: not counted.

        Raises:
            OSError: The summary cannot be written; the messages can be recovered.
        """
        if self._file.is_closed:
            return
        contents = BagContents(
            file_name=self._file.path.name,
            counts={topic: self._counts[name] for name, (topic, _) in self._topics.items()},
            first_ns=self._first_ns or 0,
            last_ns=self._last_ns,
        )
        if losses is not None:
            self._losses = losses.entries
        information = bag_information(contents, self._distribution, self._losses)
        text = yaml.safe_dump(information, sort_keys=False)
        try:
            self._file.require_whole()
            if losses is not None:
                self._file.add_metadata(METADATA_NAME, losses.entries)
            self._file.add_metadata(ROSBAG2_NAME, {"serialized_metadata": text})
            self._file.finish()
        finally:
            self._file.abandon()
        write_metadata(self._folder, information)


def bag_information(
    contents: BagContents,
    distribution: str = "jazzy",
    custom_data: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return rosbag2's description of a bag of one file, with ``custom_data``.

    Raises:
        NotFoundError: A topic's type is not installed here.
    """
    count = sum(contents.counts.values())
    start = {"nanoseconds_since_epoch": contents.first_ns}
    duration = {"nanoseconds": contents.last_ns - contents.first_ns}
    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": dict(duration),
        "starting_time": dict(start),
        "message_count": count,
        "topics_with_message_count": [
            _topic_information(*item) for item in contents.counts.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [contents.file_name],
        "files": [
            {
                "path": contents.file_name,
                "starting_time": start,
                "duration": duration,
                "message_count": count,
            }
        ],
        "custom_data": None if custom_data is None else dict(custom_data),
        "ros_distro": distribution,
    }


def _topic_information(topic: RecordedTopic, count: int) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": list(topic.qos_profiles),
            "type_description_hash": type_hash(topic.type_name),
        },
        "message_count": count,
    }


def write_metadata(folder: Path, information: dict[str, Any]) -> None:
    """Write ``metadata.yaml`` from `bag_information`; the file appears complete."""
    draft = folder / f"{METADATA_FILE}.tmp"
    document = {"rosbag2_bagfile_information": information}
    draft.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    draft.replace(folder / METADATA_FILE)
