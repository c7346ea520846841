"""Saves what a recorder that was killed had written."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import IO

import yaml
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Message, Schema

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic

Entry = tuple[Schema, Channel, Message]


def recover(file: Path, out: Path) -> int:
    """Copy all whole messages of a bag's file into a new bag and return their number.

    Args:
        file: An ``.mcap`` file that may end anywhere.
        out: Folder of the new bag.

    Raises:
        InvalidInputError: ``file`` holds no whole message, or ``out`` is not empty.
        NotFoundError: The type of a topic is not installed here.
    """
    with file.open("rb") as stream:
        entries = _whole_messages(stream)
        first = next(entries, None)
        if first is None:
            raise InvalidInputError("bag", str(file), "an MCAP file with at least one message")
        with BagWriter(out) as bag:
            for schema, channel, message in chain([first], entries):
                profiles = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or ()
                bag.add_topic(RecordedTopic(channel.topic, schema.name, tuple(profiles)))
                bag.write(channel.topic, message.data, message.log_time, message.publish_time)
            return bag.message_count


def _whole_messages(stream: IO[bytes]) -> Iterator[Entry]:
    """Yield messages in the file's order, up to its end or to where it cannot be read."""
    try:
        for schema, channel, message in NonSeekingReader(stream).iter_messages(
            log_time_order=False
        ):
            if schema is not None:
                yield schema, channel, message
    except (McapError, struct.error):  # the latter from a record that was cut
        return
