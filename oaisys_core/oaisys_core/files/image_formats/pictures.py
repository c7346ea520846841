"""How many pictures a file has, of which the first is read: pages of TIFF, animations."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import islice

from oaisys_core.files.image_formats.image_headers import is_png, is_tiff, png_chunks

MOST = 1000
"""Pictures that are counted."""

_MOST_TAGS = 4096

_SUBFILE = 254
_PART_OF_ANOTHER = 1 | 4
"""Bits of TIFF's NewSubfileType: a smaller copy, and a mask, of another picture of the file."""


def count_pictures(data: bytes) -> int:
    """Return the number of a file's pictures, at most `MOST`; 1 for formats without several.

    Smaller copies and masks of a picture do not count, nor does the preview in a JPEG.
    """
    try:
        if is_tiff(data):
            pages = islice(_tiff_pages(data), MOST)
            return max(sum(not bits & _PART_OF_ANOTHER for bits in pages), 1)
        if is_png(data):
            found = [content for name, content, _ in png_chunks(data) if name == b"acTL"]
            return min(max(struct.unpack_from(">I", found[0])[0], 1), MOST) if found else 1
    except struct.error:
        return 1  # what is damaged is told by its decoder
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return max(list(islice(_webp_chunks(data), MOST)).count(b"ANMF"), 1)
    return 1


def _tiff_pages(data: bytes) -> Iterator[int]:
    """Yield the NewSubfileType of each directory of a TIFF file, in their order."""
    order = "<" if data[:2] == b"II" else ">"
    is_big = struct.unpack_from(order + "H", data, 2)[0] == 43
    word, number, entry_bytes = ("Q", "Q", 20) if is_big else ("I", "H", 12)
    (place,) = struct.unpack_from(order + word, data, struct.calcsize(word))
    seen = set()
    while place and place not in seen:
        seen.add(place)
        (count,) = struct.unpack_from(order + number, data, place)
        if count > _MOST_TAGS:
            return  # damaged: else a file could have this loop go on for hours
        entries = place + struct.calcsize(number)
        end = entries + count * entry_bytes
        (following,) = struct.unpack_from(order + word, data, end)
        bits = 0
        for at in range(entries, end, entry_bytes):
            (tag,) = struct.unpack_from(order + "H", data, at)
            if tag == _SUBFILE:
                value_at = at + entry_bytes - struct.calcsize(word)
                (bits,) = struct.unpack_from(order + "I", data, value_at)
        yield bits
        place = following


def _webp_chunks(data: bytes) -> Iterator[bytes]:
    """Yield the name of each chunk of a WebP file."""
    place = 12
    while place + 8 <= len(data):
        name, length = struct.unpack_from("<4sI", data, place)
        yield name
        place += 8 + length + length % 2
