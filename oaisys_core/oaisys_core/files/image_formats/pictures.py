"""How many pictures a file has, of which the first is read: pages of TIFF, animations."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice

from oaisys_core.files.image_formats.image_headers import is_png, is_tiff, png_chunks
from oaisys_core.files.image_formats.tiff_directories import tiff_directories

MOST = 1000
"""Pictures that are counted."""

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
    """Yield the NewSubfileType of each directory of a TIFF file, up to one that is damaged."""
    with suppress(ValueError):
        for order, word, entry_bytes, places in tiff_directories(data):
            bits = 0
            for at in places:
                (tag,) = struct.unpack_from(order + "H", data, at)
                if tag == _SUBFILE:
                    value_at = at + entry_bytes - struct.calcsize(word)
                    (bits,) = struct.unpack_from(order + "I", data, value_at)
            yield bits


def _webp_chunks(data: bytes) -> Iterator[bytes]:
    """Yield the name of each chunk of a WebP file."""
    place = 12
    while place + 8 <= len(data):
        name, length = struct.unpack_from("<4sI", data, place)
        yield name
        place += 8 + length + length % 2
