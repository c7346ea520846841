"""Writes an MCAP file message by message, in constant memory.

Each message is a chunk of its own and is in the file when the call returns, so a killed process
loses none of them. The index of the chunks is kept in a temporary file until the end; the writer of
the package ``mcap`` keeps it in memory.
"""

from __future__ import annotations

import errno
import os
import struct
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from io import FileIO
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from oaisys_core.system.ending.signals import defer_signals

COMPRESSION = "zstd"
COPIED_BYTES = 2**20
"""Size of a piece when the index is copied to the end of the file."""


class McapWriter:
    """Writes schemas, channels and messages; `finish` or `abandon` closes the file.

    A record that cannot be written completely is removed: the file always ends with a whole record.

    Args:
        path: Of the file; replaced.
        profile: Of MCAP's registry, such as ``ros2``.

    Raises:
        OSError: The file cannot be written; all methods but `abandon` raise it, too.
    """

    def __init__(self, path: Path, profile: str) -> None:
        self.path = path
        # Unbuffered: a later call does not write again what could not be written.
        self._file = FileIO(path, "w")
        # On the bag's disk, so that there is room for both or for neither.
        self._index: IO[bytes] = tempfile.TemporaryFile(dir=path.parent, buffering=0)  # noqa: SIM115
        self._length = self._index_length = self._repeated_length = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        self._append(MCAP0_MAGIC + _bytes_of([Header(profile=profile, library="oaisys")]))

    @property
    def is_closed(self) -> bool:
        """Whether it was finished or abandoned."""
        return self._file.closed

    @property
    def length(self) -> int:
        """Bytes written so far."""
        return self._length

    @property
    def summary_length(self) -> int:
        """Bytes that `finish` will write, or a few less."""
        return self._index_length + self._repeated_length

    def require_whole(self) -> None:
        """Raise `OSError` where the file was deleted, moved, replaced or cut by somebody else.

        What is written into it then is lost without an error.
        """
        found, own = self.path.stat(), os.fstat(self._file.fileno())
        if not os.path.samestat(found, own):
            raise FileNotFoundError(errno.ENOENT, "another file has its name", str(self.path))
        if own.st_size < self._length:
            cut = f"cut to {own.st_size} of {self._length} bytes by somebody else"
            raise OSError(errno.EIO, cut, str(self.path))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema and return its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        with defer_signals():
            self._append_repeated(_bytes_of([schema]))
            self._schemas.append(schema)
        return schema.id

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Add a channel of CDR messages and return its id."""
        number = len(self._channels) + 1
        channel = Channel(
            id=number,
            topic=topic,
            message_encoding="cdr",
            metadata=dict(metadata),
            schema_id=schema_id,
        )
        with defer_signals():
            self._append_repeated(_bytes_of([channel]))
            self._channels.append(channel)
            self._counts[number] = 0
        return number

    def add_message(self, channel_id: int, log_ns: int, data: bytes, publish_ns: int) -> None:
        """Write a message, numbered within its channel."""
        message = Message(
            channel_id=channel_id,
            log_time=log_ns,
            data=data,
            publish_time=publish_ns,
            sequence=self._counts[channel_id],
        )
        content = _bytes_of([message])
        compressed = zstandard.compress(content)
        chunk = _bytes_of(
            [
                Chunk(
                    compression=COMPRESSION,
                    data=compressed,
                    message_start_time=log_ns,
                    message_end_time=log_ns,
                    uncompressed_crc=zlib.crc32(content),
                    uncompressed_size=len(content),
                )
            ]
        )
        within = _bytes_of([MessageIndex(channel_id=channel_id, records=[(log_ns, 0)])])
        index = ChunkIndex(
            chunk_start_offset=self._length,
            chunk_length=len(chunk),
            compression=COMPRESSION,
            compressed_size=len(compressed),
            uncompressed_size=len(content),
            message_start_time=log_ns,
            message_end_time=log_ns,
            message_index_length=len(within),
            message_index_offsets={channel_id: self._length + len(chunk)},
        )
        with defer_signals():  # an interruption in between left a bag with a wrong summary
            self._append(chunk + within, index=_bytes_of([index]))
            self._counts[channel_id] += 1
            self._start_ns = log_ns if self._start_ns is None else min(self._start_ns, log_ns)
            self._end_ns = max(self._end_ns, log_ns)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        record = _bytes_of([Metadata(name=name, metadata=dict(values))])
        index = MetadataIndex(offset=self._length, length=len(record), name=name)
        with defer_signals():
            self._append(record)
            self._metadata.append(index)

    def finish(self) -> None:
        """Write the summary and close; where that fails, the file ends with its last message."""
        end = self._length
        try:
            self._append(_bytes_of([DataEnd(data_section_crc=0)]))
            self._append_summary()
        except OSError:
            self._truncate(end)
            raise
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close without a summary."""
        self._index.close()
        self._file.close()

    def _append_summary(self) -> None:
        summary_start = self._length
        crc = 0
        offsets = []
        for opcode, parts in self._summary_groups():
            group_start = self._length
            for part in parts:
                crc = zlib.crc32(part, crc)
                self._append(part)
            length = self._length - group_start
            if length:
                offsets.append(SummaryOffset(opcode, group_start, length))
        offsets_start = self._length
        part = _bytes_of(offsets)
        head = (Opcode.FOOTER, 8 + 8 + 4, summary_start, offsets_start)
        crc = zlib.crc32(struct.pack("<BQQQ", *head), zlib.crc32(part, crc))
        footer = Footer(summary_start, offsets_start, crc)
        self._append(part + _bytes_of([footer]) + MCAP0_MAGIC)

    def _summary_groups(self) -> Iterator[tuple[Opcode, Iterator[bytes]]]:
        """Yield the summary's groups: the opcode of their records, and their bytes in pieces."""
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={id_: count for id_, count in self._counts.items() if count},
            chunk_count=sum(self._counts.values()),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=self._start_ns or 0,
            message_end_time=self._end_ns,
            schema_count=len(self._schemas),
        )
        yield Opcode.SCHEMA, iter([_bytes_of(self._schemas)])
        yield Opcode.CHANNEL, iter([_bytes_of(self._channels)])
        yield Opcode.STATISTICS, iter([_bytes_of([statistics])])
        yield Opcode.CHUNK_INDEX, self._index_pieces()
        yield Opcode.METADATA_INDEX, iter([_bytes_of(self._metadata)])

    def _index_pieces(self) -> Iterator[bytes]:
        self._index.seek(0)
        while piece := self._index.read(COPIED_BYTES):
            yield piece

    def _append_repeated(self, data: bytes) -> None:
        """Write records that the summary repeats."""
        self._append(data)
        self._repeated_length += len(data)

    def _append(self, data: bytes, index: bytes = b"") -> None:
        """Write to the file and to the index, both or neither."""
        try:
            _write_all(self._file, data)
            _write_all(self._index, index)
        except OSError:
            self._truncate(self._length)
            raise
        self._length += len(data)
        self._index_length += len(index)

    def _truncate(self, length: int) -> None:
        for file, end in ((self._file, length), (self._index, self._index_length)):
            file.truncate(end)
            file.seek(end)


def _write_all(file: IO[bytes] | FileIO, data: bytes) -> None:
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


def _bytes_of(records: Sequence[McapRecord]) -> bytes:
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
