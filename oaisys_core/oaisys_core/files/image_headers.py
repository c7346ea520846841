"""Sizes of images as their files' headers say, found without decoding anything.

Only formats with a row here are decoded, because a decoder recognizes others by itself.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from math import ceil
from typing import NamedTuple

from oaisys_core.errors import quote

FORMATS = "PNG, JPEG, TIFF, BMP, WebP or PNM"

_TAGS = {
    256: "width",
    257: "height",
    277: "samples",
    322: "tile_width",
    323: "tile_height",
    258: "bits",
    262: "meaning",
    274: "orientation",
}
_TIFF_VALUES = {3: "H", 4: "I", 16: "Q"}
_MAX_TAGS = 4096
_MOST_BITS = 64
_NO_FRAME = (0xC4, 0xC8, 0xCC)
"""Markers among those of a JPEG's frames that are none: tables and extensions."""
_PNM_GAP = rb"(?:\s|#[^\n]*\n)+"
_PNM_SIZE = rb"P[1-6]" + _PNM_GAP + rb"(\d{1,9})" + _PNM_GAP + rb"(\d{1,9})"
_LONGEST_TEXT_HEADER = 65_536


def image_size(data: bytes) -> tuple[int, int]:
    """Return width and height of the pixels that decoding a file would fill.

    Raises:
        ValueError: It is none of `FORMATS`, or its header is damaged.
    """
    for start, size in _KINDS.items():
        if data.startswith(start):
            try:
                width, height = size(data)
            except (struct.error, KeyError, IndexError) as error:
                raise ValueError("its header is damaged") from error
            if width < 1 or height < 1:
                raise ValueError(f"its header says {width} x {height} pixels")
            return width, height
    raise ValueError(f"it is not a {FORMATS} file")


class StoredValues(NamedTuple):
    """How an image's file has its values.

    Attributes:
        largest: What a value may be at most; 255 for the colours of a palette.
        is_scaled: Whether OpenCV makes 8 or 16 bits of them, if they have fewer.
        starts_white: Whether 0 is white, as in TIFF's MinIsWhite.
    """

    largest: int = 255
    is_scaled: bool = True
    starts_white: bool = False


def values_of(data: bytes) -> StoredValues:
    """Return how the file of an image that `image_size` knows has its values.

    Raises:
        ValueError: Its header is damaged.
    """
    try:
        if data.startswith(b"\x89PNG"):
            has_palette = data[25] == 3
            return StoredValues() if has_palette else StoredValues(2 ** data[24] - 1)
        if data[:2] in (b"II", b"MM"):
            tags = _tiff_tags(data)
            if tags.get("meaning") == 3:  # a palette
                return StoredValues()
            bits = tags.get("bits", 1)
            if bits > _MOST_BITS:
                raise ValueError(f"it has values of {bits} bits, more than {_MOST_BITS}")
            return StoredValues(2**bits - 1, starts_white=tags.get("meaning") == 0)
        if data.startswith(b"BM") and data[28:30] == b"\x10\0":
            return StoredValues(31)
        if data.startswith(b"P"):
            return _pnm_values(data)
    except (struct.error, KeyError, IndexError) as error:
        raise ValueError("its header is damaged") from error
    return StoredValues()


def _pnm_values(data: bytes) -> StoredValues:
    if data[1:2] in b"14":
        return StoredValues(1)
    found = re.match(_PNM_SIZE + _PNM_GAP + rb"(\d{1,5})\s", data[:4096])
    if found is None:
        raise ValueError("its header is damaged")
    return StoredValues(int(found[3]), is_scaled=False)


class RadianceHeader(NamedTuple):
    """What the header of a Radiance (``.hdr``) file says.

    Attributes:
        width: Of the image.
        height: Of the image.
        start: Place of the pixels in the file.
        factors: By which red, green and blue were multiplied when the file was written.
    """

    width: int
    height: int
    start: int
    factors: tuple[float, float, float]


def radiance_header(data: bytes) -> RadianceHeader:
    """Return the header of a Radiance file.

    Raises:
        ValueError: It is no such file, its rows do not go from the top to the bottom, its pixels
            are not red, green and blue, or an exposure is no number above 0.
    """
    head = data[:_LONGEST_TEXT_HEADER]
    found = re.match(rb"#\?[^\n]*\n(?:[^\n]+\n)*\n-Y (\d{1,9}) \+X (\d{1,9})\n", head)
    formats = [] if found is None else re.findall(rb"\nFORMAT=[ \t]*(\S*)", found[0])
    if found is None or not formats:
        raise ValueError("it is not a Radiance file with rows from the top to the bottom")
    for other in {*formats} - {b"32-bit_rle_rgbe"}:
        raise ValueError(f"its pixels are {_text(other)}, not 32-bit_rle_rgbe")
    factors = _radiance_factors(found[0])
    return RadianceHeader(int(found[2]), int(found[1]), found.end(), factors)


def _radiance_factors(head: bytes) -> tuple[float, float, float]:
    """Return the product of all exposures and colour corrections in a Radiance file's header."""
    product = [1.0, 1.0, 1.0]
    for name, text in re.findall(rb"\n(EXPOSURE|COLORCORR)=([^\n]*)", head):
        try:
            values = [float(value) for value in text.split()]
        except ValueError:
            values = []
        if len(values) != (1 if name == b"EXPOSURE" else 3) or not all(map(_is_factor, values)):
            raise ValueError(f"its header says {_text(name + b'=' + text)}")
        of_colors = values * (3 // len(values))
        product = [all_ * each for all_, each in zip(product, of_colors, strict=True)]
    if not all(map(_is_factor, product)):
        raise ValueError(f"the exposures and colour corrections in its header make {product}")
    return product[0], product[1], product[2]


def _is_factor(value: float) -> bool:
    return 1e-30 < value < 1e30


def _text(data: bytes) -> str:
    return quote(data.decode("ascii", "replace"))


def tiff_orientation(data: bytes) -> int:
    """Return where a TIFF file's first row and column belong, 1 to 8: 1 is at the top and left.

    Raises:
        ValueError: Its header is damaged.
    """
    try:
        return _tiff_tags(data).get("orientation", 1)
    except (struct.error, KeyError) as error:
        raise ValueError("its header is damaged") from error


def _png(data: bytes) -> tuple[int, int]:
    if data[12:16] != b"IHDR":
        raise ValueError("its header is damaged")
    return struct.unpack(">II", data[16:24])


def _jpeg(data: bytes) -> tuple[int, int]:
    """Return the size in the one frame of a JPEG file; its segments before the pixels are read."""
    place, sizes = 2, []
    while True:
        place = data.index(b"\xff", place) if b"\xff" in data[place:] else len(data)
        while data[place] == 0xFF:
            place += 1
        marker = data[place]
        place += 1
        if marker == 0xDA:  # the pixels follow
            break
        if marker in (0x00, 0x01) or 0xD0 <= marker <= 0xD8:
            continue
        (length,) = struct.unpack(">H", data[place : place + 2])
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME:
            height, width = struct.unpack(">HH", data[place + 3 : place + 7])
            sizes.append((width, height))
        place += length
    if len(sizes) != 1:
        raise ValueError(f"it has {len(sizes)} frames, not one")
    return sizes[0]


def _tiff(data: bytes) -> tuple[int, int]:
    """Return the size of a TIFF file's first image, rounded up to whole tiles."""
    found = _tiff_tags(data)
    if found.get("samples", 1) > 4:
        raise ValueError(f"it has {found['samples']} channels, more than 4")
    width, height = found["width"], found["height"]
    tile_width, tile_height = found.get("tile_width", 1), found.get("tile_height", 1)
    return _whole(width, tile_width), _whole(height, tile_height)


def _tiff_tags(data: bytes) -> dict[str, int]:
    """Return the numbers in the tags of a TIFF file's first image, of several the first."""
    order = "<" if data[:2] == b"II" else ">"
    is_big = struct.unpack(order + "H", data[2:4])[0] == 43
    word, entry_bytes = ("Q", 20) if is_big else ("I", 12)
    word_bytes = struct.calcsize(word)
    (place,) = struct.unpack_from(order + word, data, word_bytes)
    (count,) = struct.unpack_from(order + ("Q" if is_big else "H"), data, place)
    place += 8 if is_big else 2
    if count > _MAX_TAGS:
        raise ValueError(f"it has {count} tags, more than {_MAX_TAGS}")
    found: dict[str, int] = {}
    for number in range(count):
        at = place + number * entry_bytes
        tag, kind = struct.unpack_from(order + "HH", data, at)
        if tag not in _TAGS:
            continue
        name = _TAGS[tag]
        if name in found:
            raise ValueError(f"it has tag {tag} twice")
        form = _TIFF_VALUES[kind]
        (length,) = struct.unpack_from(order + word, data, at + 4)
        value_at = at + entry_bytes - word_bytes
        if name == "bits" and length * struct.calcsize(form) > word_bytes:
            (value_at,) = struct.unpack_from(order + word, data, value_at)
        (found[name],) = struct.unpack_from(order + form, data, value_at)
    return found


def _whole(size: int, part: int) -> int:
    return ceil(size / part) * part if part else 0


def _bmp(data: bytes) -> tuple[int, int]:
    (header_bytes,) = struct.unpack("<I", data[14:18])
    if header_bytes == 12:
        return struct.unpack("<HH", data[18:22])
    width, height = struct.unpack("<ii", data[18:26])
    return width, abs(height)


def _webp(data: bytes) -> tuple[int, int]:
    kind = data[12:16]
    if data[8:12] != b"WEBP":
        raise ValueError(f"it is not a {FORMATS} file")
    if kind == b"VP8X":
        return (
            1 + int.from_bytes(data[24:27], "little"),
            1 + int.from_bytes(data[27:30], "little"),
        )
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack("<HH", data[26:30])
    return width & 0x3FFF, height & 0x3FFF


def _pnm(data: bytes) -> tuple[int, int]:
    found = re.match(_PNM_SIZE + rb"\s", data[:4096])
    if found is None:
        raise ValueError("its header is damaged")
    return int(found[1]), int(found[2])


_KINDS: dict[bytes, Callable[[bytes], tuple[int, int]]] = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8\xff": _jpeg,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"II+\0": _tiff,
    b"MM\0+": _tiff,
    b"BM": _bmp,
    b"RIFF": _webp,
    **{b"P%d" % kind: _pnm for kind in range(1, 7)},
}
"""Functions that find the size, by the first bytes of a format."""
