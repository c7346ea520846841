"""The records of an MCAP file, read within the bounds of the file, whatever their lengths say."""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO, Any, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Message
from mcap.writer import MCAP0_MAGIC

from oaisys_core.errors import LONGEST_FIELD, OaisysError, quote

MAGIC = MCAP0_MAGIC
LARGEST_CHUNK_BYTES = 2**30
"""Of a chunk, unpacked: larger ones are refused before they are."""

MOST_LISTED = 20
"""Names that an error lists."""

FOOTER_BYTES = 9 + 20
_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_MIN_BYTES = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: _MESSAGE.size,
    Opcode.CHUNK: _CHUNK.size + 12,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 40,
    Opcode.ATTACHMENT_INDEX: 48,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
    Opcode.SUMMARY_OFFSET: 17,
    Opcode.DATA_END: 4,
}
"""Bytes that a record of each kind has at least; other kinds are not those of MCAP."""

_PERHAPS = re.compile(rb"[\x01-\x0f](?=.{5}\x00{3})", re.DOTALL)
"""Where a record of less than a terabyte may begin."""

_BLOCK_BYTES = 2**20

RecordType = TypeVar("RecordType")


class DamagedRecordError(OaisysError):
    """A record cannot be read; the message says why."""


@dataclass(frozen=True)
class RecordPlace:
    """Where a record lies in a file: its kind, its first byte, its content, its end."""

    opcode: int
    offset: int
    end: int

    @property
    def content_offset(self) -> int:
        """First byte of its content."""
        return self.offset + _HEADER.size


class RecordFile:
    """An MCAP file that is open.

    Args:
        stream: May end anywhere, and hold anything.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.size = stream.seek(0, os.SEEK_END)

    def read(self, offset: int, end: int) -> bytes:
        """Return the bytes from ``offset`` to ``end``, or to the end of the file."""
        self._stream.seek(offset)
        return self._stream.read(max(0, min(end, self.size) - offset))

    def content(self, place: RecordPlace) -> bytes:
        """Return the content of a record."""
        return self.read(place.content_offset, place.end)

    def place_at(self, offset: int) -> RecordPlace | None:
        """Return the record that begins there; None: none does, or not all of it is there."""
        head = self.read(offset, offset + _HEADER.size)
        if len(head) < _HEADER.size:
            return None
        opcode, length = _HEADER.unpack(head)
        end = offset + _HEADER.size + length
        if end > self.size or length < _MIN_BYTES.get(opcode, self.size):
            return None
        place = RecordPlace(opcode, offset, end)
        return None if opcode == Opcode.CHUNK and not self._is_whole_chunk(place) else place

    def places(
        self, offset: int, on_gap: Callable[[int, int], None] | None = None
    ) -> Iterator[RecordPlace]:
        """Yield the records from ``offset`` on, in the file's order.

        Args:
            offset: Where the first one begins.
            on_gap: Given the begin and the end of bytes that are no records, which are skipped.

        Raises:
            DamagedRecordError: There are such bytes, and ``on_gap`` is None.
        """
        while offset < self.size and not self._is_end(offset):
            place = self.place_at(offset)
            if place is None:
                if on_gap is None:
                    raise DamagedRecordError(f"no record begins at byte {offset}")
                next_offset = self._next_after(offset)
                on_gap(offset, next_offset)
                offset = next_offset
                continue
            yield place
            offset = place.end

    def _is_end(self, offset: int) -> bool:
        return offset + len(MAGIC) == self.size and self.read(offset, self.size) == MAGIC

    def _is_whole_chunk(self, place: RecordPlace) -> bool:
        """Return whether the lengths in a chunk fit together."""
        start = place.content_offset + _CHUNK.size
        (name,) = struct.unpack("<I", self.read(start, start + 4))
        if name > place.end - start:
            return False
        length = self.read(start + 4 + name, start + 12 + name)
        return len(length) == 8 and start + 12 + name + struct.unpack("<Q", length)[0] == place.end

    def _next_after(self, offset: int) -> int:
        """Return where the next record begins after damage; the file's size: there is none."""
        overlap = _HEADER.size
        for begin in range(offset + 1, self.size, _BLOCK_BYTES):
            block = self.read(begin, begin + _BLOCK_BYTES + overlap)
            for found in _PERHAPS.finditer(block):
                place = self.place_at(begin + found.start())
                if place is not None and self._is_followed(place):
                    return place.offset
        return self.size

    def _is_followed(self, place: RecordPlace) -> bool:
        """Return whether a record's end is that of the file, or another one begins there."""
        at_end = place.end == self.size or self._is_end(place.end)
        return at_end or self.place_at(place.end) is not None


def printable(name: str) -> str:
    """Return a name from a file as a terminal may show it; of a long one, begin and end."""
    if len(name) > LONGEST_FIELD:
        return quote(name)
    return name if name.isprintable() else ascii(name)


def list_names(names: Iterable[str]) -> str:
    """Return names from a file, sorted; of many only the first."""
    ordered = sorted(names)
    shown = ", ".join(map(printable, ordered[:MOST_LISTED]))
    more = len(ordered) - MOST_LISTED
    return f"{shown} and {more} more" if more > 0 else shown


def parse_record(kind: type[RecordType], content: bytes) -> RecordType:
    """Return a record of `mcap.records` from its content.

    Raises:
        DamagedRecordError: It is no such record.
    """
    reader: Any = kind
    try:
        return reader.read(ReadDataStream(BytesIO(content)))  # type: ignore[no-any-return]
    except (McapError, struct.error, ValueError, OverflowError, MemoryError) as error:
        raise DamagedRecordError(f"a record of the kind {kind.__name__} is damaged") from error


def parse_message(content: bytes) -> Message:
    """Return a message from its content; `DamagedRecordError` where it is too short."""
    if len(content) < _MESSAGE.size:
        raise DamagedRecordError("a message is cut short")
    channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(content)
    return Message(
        channel_id=channel,
        log_time=log_ns,
        data=content[_MESSAGE.size :],
        publish_time=publish_ns,
        sequence=sequence,
    )


def chunk_records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of the records in a chunk.

    Raises:
        DamagedRecordError: The chunk cannot be unpacked, or is not what its checksum says, or a
            record in it is no record.
    """
    data = _unpack(content)
    offset = 0
    while offset < len(data):
        head = data[offset : offset + _HEADER.size]
        opcode, length = _HEADER.unpack(head) if len(head) == _HEADER.size else (0, len(data))
        end = offset + _HEADER.size + length
        if opcode not in _MIN_BYTES or end > len(data):
            raise DamagedRecordError("a record in a chunk is cut short, or none")
        if opcode == Opcode.CHUNK:
            raise DamagedRecordError("a chunk contains a chunk")
        yield opcode, data[offset + _HEADER.size : end]
        offset = end


def _unpack(content: bytes) -> bytes:
    _, _, size, checksum = _CHUNK.unpack_from(content)
    (name_length,) = struct.unpack_from("<I", content, _CHUNK.size)
    begin = _CHUNK.size + 4
    name = content[begin : begin + name_length].decode("utf-8", "replace")
    packed = content[begin + name_length + 8 :]
    if size > LARGEST_CHUNK_BYTES:
        raise DamagedRecordError(f"a chunk of {size} bytes is larger than {LARGEST_CHUNK_BYTES}")
    if name not in _UNPACKERS:
        raise DamagedRecordError(f"the compression {name[:80]!r} of a chunk is not known")
    try:
        data = _UNPACKERS[name](packed, size)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamagedRecordError(f"a chunk cannot be unpacked ({name})") from error
    if len(data) != size:
        raise DamagedRecordError("a chunk is not as long as it says")
    if checksum and zlib.crc32(data) != checksum:
        raise DamagedRecordError("the checksum of a chunk is wrong")
    return data


def _from_zstd(packed: bytes, size: int) -> bytes:
    """Unpack until a byte more than ``size`` has come."""
    pieces: list[bytes] = []
    with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
        while sum(map(len, pieces)) <= size and (piece := reader.read(min(size + 1, 2**26))):
            pieces.append(piece)
    return b"".join(pieces)


def _from_lz4(packed: bytes, size: int) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))


_UNPACKERS: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, _: packed,
    "zstd": _from_zstd,
    "lz4": _from_lz4,
}
