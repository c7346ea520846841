"""A finished MCAP file: its summary, and its messages in the order in which they were received."""

from __future__ import annotations

import heapq
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.summary import Summary

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.yaml_documents import parse_yaml
from oaisys_ros_bridge.bags.mcap_format.mcap_records import (
    FOOTER_BYTES,
    MAGIC,
    DamagedRecordError,
    RecordFile,
    chunk_records,
    parse_message,
    parse_record,
)
from oaisys_ros_bridge.bags.writing import RecordedTopic

DEEPEST_QUEUE = 2**20
"""Messages that a queue of a publisher may have held."""

FINISHED = "a finished MCAP file; `oaisys bag recover` saves what one holds that was cut short"


class FinishedBag:
    """A file with a summary.

    Args:
        file: Open as long as this is used.

    Raises:
        DamagedRecordError: It has no summary, or a damaged one.

    Attributes:
        summary: Whose channels all have schemas.
    """

    def __init__(self, file: RecordFile) -> None:
        self._file = file
        self.summary = read_summary(file)

    def iter_messages(
        self, topics: Collection[str]
    ) -> Iterator[tuple[Schema | None, Channel, Message]]:
        """Yield the messages of some topics in the order in which they were received.

        As readers of `mcap` do, with each one's type and channel.

        Raises:
            DamagedRecordError: A part of the file that is needed is damaged.
        """
        wanted = {id_ for id_, channel in self.summary.channels.items() if channel.topic in topics}
        order = count()
        # Chunks may overlap in time: one is read when no earlier message can come from another.
        waiting: list[tuple[int, int, ChunkIndex | Message]] = [
            (index.message_start_time, next(order), index)
            for index in self.summary.chunk_indexes
            if not index.message_index_offsets or wanted & index.message_index_offsets.keys()
        ]
        if not self.summary.chunk_indexes:
            found = (m for m in self._messages_without_index() if m.channel_id in wanted)
            waiting = [(message.log_time, next(order), message) for message in found]
        heapq.heapify(waiting)
        while waiting:
            _, _, next_one = heapq.heappop(waiting)
            if isinstance(next_one, Message):
                channel = self.summary.channels[next_one.channel_id]
                yield self.summary.schemas.get(channel.schema_id), channel, next_one
                continue
            for message in self._messages_of(next_one.chunk_start_offset):
                if message.channel_id in wanted:
                    heapq.heappush(waiting, (message.log_time, next(order), message))

    def metadata(self, name: str) -> Mapping[str, str] | None:
        """Return the first metadata of a name; None: there is none."""
        for index in self.summary.metadata_indexes:
            place = self._file.place_at(index.offset)
            if index.name == name and place is not None and place.opcode == Opcode.METADATA:
                return parse_record(Metadata, self._file.content(place)).metadata
        return None

    def _messages_of(self, offset: int) -> Iterator[Message]:
        place = self._file.place_at(offset)
        if place is None or place.opcode != Opcode.CHUNK:
            raise DamagedRecordError(f"no chunk begins at byte {offset}")
        for opcode, content in chunk_records(self._file.content(place)):
            if opcode == Opcode.MESSAGE:
                yield parse_message(content)

    def _messages_without_index(self) -> Iterator[Message]:
        for place in self._file.places(len(MAGIC)):
            if place.opcode == Opcode.MESSAGE:
                message = parse_message(self._file.content(place))
                yield message
            elif place.opcode == Opcode.CHUNK:
                yield from self._messages_of(place.offset)


def read_summary(file: RecordFile) -> Summary:
    """Return a file's summary, once its checksum is right and its parts belong together.

    Raises:
        DamagedRecordError: They do not, or there is none.
    """
    end = file.size - len(MAGIC) - FOOTER_BYTES
    place = file.place_at(end) if end > 0 else None
    if file.read(0, len(MAGIC)) != MAGIC or file.read(file.size - len(MAGIC), file.size) != MAGIC:
        raise DamagedRecordError("it does not begin and end as an MCAP file")
    if place is None or place.opcode != Opcode.FOOTER:
        raise DamagedRecordError("it has no footer")
    footer = parse_record(Footer, file.content(place))
    if not 0 < footer.summary_start <= end:
        raise DamagedRecordError("it has no summary")
    checked = file.read(footer.summary_start, file.size - len(MAGIC) - 4)
    if footer.summary_crc and zlib.crc32(checked) != footer.summary_crc:
        raise DamagedRecordError("the checksum of its summary is wrong")
    summary = Summary()
    for record in file.places(footer.summary_start):
        _add(summary, record.opcode, file.content(record))
    for channel in summary.channels.values():
        if channel.schema_id not in summary.schemas:
            raise DamagedRecordError(f"the type of {channel.topic[:80]!r} is not described")
    return summary


def _add(summary: Summary, opcode: int, content: bytes) -> None:
    if opcode == Opcode.STATISTICS:
        summary.statistics = parse_record(Statistics, content)
    elif opcode == Opcode.SCHEMA:
        schema = parse_record(Schema, content)
        summary.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = parse_record(Channel, content)
        summary.channels[channel.id] = channel
    elif opcode == Opcode.CHUNK_INDEX:
        summary.chunk_indexes.append(parse_record(ChunkIndex, content))
    elif opcode == Opcode.METADATA_INDEX:
        summary.metadata_indexes.append(parse_record(MetadataIndex, content))


def describe_topic(schema: Schema, channel: Channel) -> RecordedTopic:
    """Return the description of a topic.

    Raises:
        InvalidInputError: What its publishers offered cannot be read.
    """
    text = channel.metadata.get("offered_qos_profiles", "")
    try:
        profiles = parse_yaml(text) or ()
        if not all(0 <= int(profile.get("depth", 0)) <= DEEPEST_QUEUE for profile in profiles):
            raise ValueError("a queue is too deep")
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        expected = f"rosbag2's list of qualities of service ({error})"
        raise InvalidInputError("offered_qos_profiles", text, expected) from error
    return RecordedTopic(channel.topic, schema.name, tuple(profiles))


@contextmanager
def open_finished(path: Path) -> Iterator[tuple[FinishedBag, Summary]]:
    """Open a finished MCAP file; yield a reader and the file's summary.

    Raises:
        InvalidInputError: The file is no finished bag, or what the block reads from it is damaged.
    """
    try:
        with path.open("rb") as stream:
            bag = FinishedBag(RecordFile(stream))
            yield bag, bag.summary
    except DamagedRecordError as error:
        raise InvalidInputError("bag", str(path), f"{FINISHED} ({error})") from error
