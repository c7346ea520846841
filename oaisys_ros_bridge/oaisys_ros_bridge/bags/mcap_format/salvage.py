"""Copies what can be read of a damaged bag to a new one, and says what was lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema, Statistics
from mcap.summary import Summary

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_ros_bridge.bags.losses import METADATA_NAME, BagLosses
from oaisys_ros_bridge.bags.mcap_format.finished_bag import describe_topic, read_summary
from oaisys_ros_bridge.bags.mcap_format.mcap_records import (
    MAGIC,
    DamagedRecordError,
    RecordFile,
    RecordPlace,
    chunk_records,
    parse_message,
    parse_record,
    printable,
)
from oaisys_ros_bridge.bags.mcap_format.message_definition import message_definition, type_hash
from oaisys_ros_bridge.bags.writing import ROSBAG2_NAME, BagWriter, RecordedTopic

MAX_METADATA_BYTES = 2**24
"""Of all metadata records that are copied."""

NOT_DESCRIBED = "topics that nothing describes"


class _SalvagedRecords:
    """The messages and metadata of a file that can be read, and counts of what cannot."""

    def __init__(self, file: RecordFile) -> None:
        self._file = file
        self._skipped_chunk = False
        self._trusted = Summary()
        with suppress(DamagedRecordError):
            self._trusted = read_summary(file)
        self._schemas = dict(self._trusted.schemas)
        self._channels = dict(self._trusted.channels)
        self._statistics = self._trusted.statistics
        self.read_count = 0
        self.damage: Counter[str] = Counter()
        self.first_places: dict[str, int] = {}
        self.gaps: list[tuple[int, int]] = []
        self.lost_by_topic: Counter[str] = Counter()
        self.reasons: list[str] = []
        self.metadata: list[Metadata] = []
        self._metadata_bytes = 0
        self._left_out: Counter[str] = Counter()

    def messages(self) -> Iterator[tuple[Schema, Channel, Message]]:
        """Yield messages with their channels, in the file's order."""
        begin = len(MAGIC) if self._file.read(0, len(MAGIC)) == MAGIC else 0
        for place in self._file.places(begin, lambda *gap: self.gaps.append(gap)):
            try:
                yield from self._messages_of(place)
            except DamagedRecordError as error:
                self._skipped_chunk = place.opcode == Opcode.CHUNK
                self.damage[str(error)] += 1
                self.first_places.setdefault(str(error), place.offset)

    def _messages_of(self, place: RecordPlace) -> Iterator[tuple[Schema, Channel, Message]]:
        content = self._file.content(place)
        if place.opcode == Opcode.CHUNK:
            self._skipped_chunk = False
            # All of a chunk or nothing: what precedes a damage in it has no checksum of its own.
            for opcode, part in list(chunk_records(content)):
                yield from self._message(opcode, part)
        elif place.opcode == Opcode.MESSAGE_INDEX and self._skipped_chunk:
            self.lose(int.from_bytes(content[:2], "little"), (len(content) - 6) // 16)
        elif place.opcode == Opcode.STATISTICS:
            self._statistics = self._statistics or parse_record(Statistics, content)
        elif place.opcode == Opcode.METADATA:
            self._keep_metadata(content)
        elif place.opcode == Opcode.ATTACHMENT:
            self._left_out["attachments"] += 1
        else:
            yield from self._message(place.opcode, content)

    def _keep_metadata(self, content: bytes) -> None:
        self._metadata_bytes += len(content)
        if self._metadata_bytes > MAX_METADATA_BYTES:
            self._left_out[f"metadata records beyond {MAX_METADATA_BYTES >> 20} MB"] += 1
            return
        found = parse_record(Metadata, content)
        if found.name == ROSBAG2_NAME:
            return  # describes the old file
        if found.name == METADATA_NAME:
            try:
                BagLosses.read(found.metadata)
            except InvalidInputError as error:
                self.reasons.append(f"its record of what was lost cannot be read: {error}")
                return
        self.metadata.append(found)

    def _message(self, opcode: int, content: bytes) -> Iterator[tuple[Schema, Channel, Message]]:
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, content)
            if schema.id not in self._trusted.schemas:
                self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, content)
            if channel.id not in self._trusted.channels:
                self._channels[channel.id] = channel
        elif opcode == Opcode.MESSAGE:
            message = parse_message(content)
            found = self._channels.get(message.channel_id)
            described = self._schemas.get(found.schema_id) if found is not None else None
            if found is None or described is None:
                self.lose(message.channel_id)
                return
            self.read_count += 1
            yield described, found, message

    def lose(self, channel_id: int, messages: int = 1) -> None:
        """Count messages of a channel that are not in the new bag."""
        channel = self._channels.get(channel_id)
        self.lost_by_topic[NOT_DESCRIBED if channel is None else channel.topic] += messages

    def sentences(self) -> Iterator[str]:
        """Yield what was lost, in words."""
        for reason, number in self.damage.items():
            first = self.first_places[reason]
            yield f"{number} parts skipped, the first at byte {first}: {reason}"
        if self.gaps:
            length = sum(end - begin for begin, end in self.gaps)
            first = self.gaps[0][0]
            yield f"{length} bytes from byte {first} on hold no records that can be read"
        yield from self.reasons
        for what, number in self._left_out.items():
            yield f"{what} are left out: {number}"
        for topic, number in sorted(self.lost_by_topic.items()):
            yield f"{printable(topic)}: {number} messages lost"
        counted = self._statistics.message_count if self._statistics is not None else 0
        if counted > self.read_count:
            yield f"its index counts {counted} messages, {self.read_count} could be read"


def salvage(file: RecordFile, out: Path, say: Callable[[str], None]) -> int:
    """Copy the messages and metadata of a file that can be read to a new bag; count messages.

    Args:
        file: May end anywhere, and be damaged anywhere.
        out: Folder of the bag; it is not made where no message can be read.
        say: Told what was lost, a sentence at a time.

    Raises:
        InvalidInputError: ``out`` is not empty.
    """
    records = _SalvagedRecords(file)
    topics: dict[tuple[int, str, str], RecordedTopic | None] = {}
    copied = 0
    with ExitStack() as stack:
        bag: BagWriter | None = None
        for schema, channel, message in records.messages():
            key = (channel.id, channel.topic, schema.name)
            if key not in topics:
                topics[key] = _describe(schema, channel, topics.values(), records.reasons)
            topic = topics[key]
            if topic is None:
                records.lose(channel.id)
                continue
            if bag is None:
                bag = stack.enter_context(BagWriter(out))
            bag.add_topic(topic)
            bag.write(topic.name, message.data, message.log_time, message.publish_time)
            copied += 1
        if bag is not None:
            for record in records.metadata:
                bag.add_metadata(record.name, record.metadata)
    for sentence in records.sentences():
        say(sentence)
    return copied


def _describe(
    schema: Schema, channel: Channel, others: Iterable[RecordedTopic | None], reasons: list[str]
) -> RecordedTopic | None:
    """Return a topic of the new bag; None, and a reason, where it cannot be in one."""
    name = printable(channel.topic)
    if channel.message_encoding != "cdr":
        reasons.append(f"{name}: its messages are not in CDR, as ROS 2 has them")
        return None
    types = {topic.type_name for topic in others if topic and topic.name == channel.topic}
    if types - {schema.name}:
        reasons.append(f"{name}: messages of another type have the same topic")
        return None
    try:
        message_definition(schema.name)
        type_hash(schema.name)
    except NotFoundError as error:
        reasons.append(f"{name}: {error}")
        return None
    try:
        return describe_topic(schema, channel)
    except InvalidInputError as error:
        reasons.append(f"{name}: {error}; it is unknown in the new bag")
        return RecordedTopic(channel.topic, schema.name)
