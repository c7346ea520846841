"""The directories of a TIFF file, one for each of its images."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from mmap import mmap
from typing import NamedTuple

MAX_TAGS = 4096


class TiffDirectory(NamedTuple):
    """Where the tags of an image are.

    Attributes:
        order: Of the file's bytes, as `struct` writes it.
        word: Format of offsets and counts; a tag's value begins a word before its end.
        entry_bytes: Length of a tag.
        places: Of its tags, in bytes from the file's start.
    """

    order: str
    word: str
    entry_bytes: int
    places: range


def tiff_directories(data: bytes | mmap) -> Iterator[TiffDirectory]:
    """Yield the directories of a TIFF file in their order.

    Raises:
        ValueError: One has more than `MAX_TAGS` tags: else a file could have others read for hours.
        struct.error: It ends within one.
    """
    order = "<" if data[:2] == b"II" else ">"
    is_big = struct.unpack_from(order + "H", data, 2)[0] == 43
    word, number, entry_bytes = ("Q", "Q", 20) if is_big else ("I", "H", 12)
    (place,) = struct.unpack_from(order + word, data, struct.calcsize(word))
    seen = set()
    while place not in seen:
        seen.add(place)
        (count,) = struct.unpack_from(order + number, data, place)
        if count > MAX_TAGS:
            raise ValueError(f"it has {count} tags, more than {MAX_TAGS}")
        begin = place + struct.calcsize(number)
        end = begin + count * entry_bytes
        yield TiffDirectory(order, word, entry_bytes, range(begin, end, entry_bytes))
        (place,) = struct.unpack_from(order + word, data, end)
        if not place:
            return
