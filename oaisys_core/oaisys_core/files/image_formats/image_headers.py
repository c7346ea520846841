"""Sizes of images as their files' headers say, found without decoding anything.

Only formats with a row here are decoded, because a decoder recognizes others by itself.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from itertools import islice
from math import ceil
from typing import NamedTuple

from oaisys_core.files.image_formats.tiff_directories import tiff_directories

FORMATS = "PNG, JPEG, TIFF, BMP, WebP or PNM"

_TAGS = {
    256: "width",
    257: "height",
    258: "bits",
    259: "compression",
    262: "meaning",
    274: "orientation",
    277: "samples",
    322: "tile_width",
    323: "tile_height",
    338: "extra",
}
_TIFF_VALUES = {1: "B", 3: "H", 4: "I", 16: "Q"}
_MAX_SEGMENTS = 4096
"""Of a JPEG, and chunks of a PNG before its pixels: decoders keep what each of them says."""
_MAX_SAMPLES = 4
_PNG_START = b"\x89PNG\r\n\x1a\n"
_TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_MOST_BITS = 64
MIN_IS_WHITE, MIN_IS_BLACK, RGB, PALETTE, CMYK, YCBCR = 0, 1, 2, 3, 5, 6
"""Meanings of a TIFF file's samples."""
ASSOCIATED_ALPHA, UNASSOCIATED_ALPHA = 1, 2
"""Meanings of an extra sample: with the first, colours are multiplied by opacity."""
_NO_FRAME = (0xC4, 0xC8, 0xCC)
"""Markers among those of a JPEG's frames that are none: tables and extensions."""
_JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")
"""What is in no pixels, which have a 0 behind each 255."""
_JPEG_SCAN, _JPEG_END = b"\xff\xda", b"\xff\xd9"
_MAX_SCANS = 100
"""As in GDAL; encoders write some ten."""
_PNM_GAP = rb"(?:\s|#[^\n]*\n)+"
_PNM_SIZE = rb"P[1-6]" + _PNM_GAP + rb"(\d{1,9})" + _PNM_GAP + rb"(\d{1,9})"


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
        if is_png(data):
            has_palette = data[25] == 3
            return StoredValues() if has_palette else StoredValues(2 ** data[24] - 1)
        if is_tiff(data):
            header = tiff_header(data)
            if header.meaning == PALETTE:
                return StoredValues()
            return StoredValues(2**header.bits - 1, starts_white=header.meaning == MIN_IS_WHITE)
        if data.startswith(b"BM") and data[28:30] == b"\x10\0":
            return StoredValues(31)
        if data.startswith(b"P"):
            return _pnm_values(data)
    except (struct.error, KeyError, IndexError) as error:
        raise ValueError("its header is damaged") from error
    return StoredValues()


def png_transparent(data: bytes) -> tuple[int, ...] | None:
    """Return the grey value, or red, green and blue, that a PNG says is transparent.

    It is the chunk tRNS of an image without a palette; None: there is none.

    Raises:
        ValueError: The chunk is damaged.
    """
    bits, kind = data[24:26]
    count = {0: 1, 2: 3}.get(kind)
    for name, content, checksum in png_chunks(data):
        if name == b"tRNS" and count is not None:
            is_whole = struct.pack(">I", zlib.crc32(name + content)) == checksum
            if len(content) != 2 * count or not is_whole:
                raise ValueError("its transparent value (tRNS) is damaged")
            values = struct.unpack(f">{count}H", content)
            return tuple(value & (2**bits - 1) for value in values)
    return None


def png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes, bytes]]:
    """Yield names, contents and checksums of the chunks before a PNG file's pixels."""
    place = 8
    while place + 8 <= len(data):
        length, name = struct.unpack_from(">I4s", data, place)
        if name == b"IDAT":
            return
        end = place + 8 + length
        yield name, data[place + 8 : end], data[end : end + 4]
        place = end + 4


def is_png(data: bytes) -> bool:
    """Return whether a file begins as a PNG file does."""
    return data.startswith(_PNG_START)


def _pnm_values(data: bytes) -> StoredValues:
    if data[1:2] in b"14":
        return StoredValues(1)
    found = re.match(_PNM_SIZE + _PNM_GAP + rb"(\d{1,5})\s", data[:4096])
    if found is None:
        raise ValueError("its header is damaged")
    return StoredValues(int(found[3]), is_scaled=False)


class TiffHeader(NamedTuple):
    """What the tags of a TIFF file's first image say about its samples.

    Attributes:
        samples: Of each pixel.
        bits: Of each sample.
        meaning: Of samples, the tag PhotometricInterpretation.
        compression: Its number.
        extra: Meaning of the last sample beside the colours, the tag ExtraSamples; None: there is
            no such tag.
        orientation: Where the first row and column belong, 1 to 8: 1 is at the top and left.
    """

    samples: int = 1
    bits: int = 1
    meaning: int = 1
    compression: int = 1
    extra: int | None = None
    orientation: int = 1

    @property
    def has_alpha(self) -> bool:
        """Whether the last sample is opacity."""
        return self.samples in (2, 4) and self.extra in (ASSOCIATED_ALPHA, UNASSOCIATED_ALPHA)


def is_tiff(data: bytes) -> bool:
    """Return whether a file begins as a TIFF file does."""
    return data.startswith(_TIFF_STARTS)


def tiff_header(data: bytes) -> TiffHeader:
    """Return what a TIFF file says about its samples.

    Raises:
        ValueError: Its header is damaged, or its samples have different or too many bits.
    """
    try:
        tags = _tiff_tags(data)
    except (struct.error, KeyError) as error:
        raise ValueError("its header is damaged") from error
    bits = tags.get("bits", (1,))
    if len(set(bits)) != 1:
        raise ValueError(f"its channels have different bits: {', '.join(map(str, bits))}")
    if bits[0] > _MOST_BITS:
        raise ValueError(f"it has values of {bits[0]} bits, more than {_MOST_BITS}")
    firsts = {
        name: tags[name][0]
        for name in ("samples", "meaning", "compression", "orientation")
        if name in tags
    }
    return TiffHeader(bits=bits[0], extra=tags["extra"][-1] if "extra" in tags else None, **firsts)


def _png(data: bytes) -> tuple[int, int]:
    if data[12:16] != b"IHDR":
        raise ValueError("its header is damaged")
    if next(islice(png_chunks(data), _MAX_SEGMENTS, None), None):
        raise ValueError(f"it has more than {_MAX_SEGMENTS} chunks before its pixels")
    return struct.unpack(">II", data[16:24])


def _jpeg(data: bytes) -> tuple[int, int]:
    """Return the size in the one frame of a JPEG file; its segments before the pixels are read."""
    place, sizes, segments = 2, [], 0
    while True:
        place = data.find(b"\xff", place)
        segments += 1
        if place < 0 or segments > _MAX_SEGMENTS:
            raise ValueError(f"it has no pixels, or more than {_MAX_SEGMENTS} segments before them")
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
    _check_scans(data, place - 2)
    return sizes[0]


def _check_scans(data: bytes, place: int) -> None:
    """Raise if a JPEG has too many scans: each passes over all pixels, however short it is."""
    scans = markers = 0
    while (found := _JPEG_MARKER.search(data, place)) and found[0] != _JPEG_END:
        markers += 1
        scans += found[0] == _JPEG_SCAN
        if scans > _MAX_SCANS or markers > _MAX_SEGMENTS:
            raise ValueError(f"it has more than {_MAX_SCANS} scans or {_MAX_SEGMENTS} segments")
        place = found.end() + int.from_bytes(data[found.end() : found.end() + 2], "big")


def _tiff(data: bytes) -> tuple[int, int]:
    """Return the size of a TIFF file's first image, rounded up to whole tiles."""
    found = {name: values[0] for name, values in _tiff_tags(data).items()}
    if found.get("samples", 1) > _MAX_SAMPLES:
        raise ValueError(f"it has {found['samples']} channels, more than {_MAX_SAMPLES}")
    width, height = found["width"], found["height"]
    tile_width, tile_height = found.get("tile_width", 1), found.get("tile_height", 1)
    return _whole(width, tile_width), _whole(height, tile_height)


def _tiff_tags(data: bytes) -> dict[str, tuple[int, ...]]:
    """Return the first numbers in the tags of a TIFF file's first image."""
    order, word, entry_bytes, places = next(tiff_directories(data))
    word_bytes = struct.calcsize(word)
    found: dict[str, tuple[int, ...]] = {}
    for at in places:
        tag, kind = struct.unpack_from(order + "HH", data, at)
        if tag not in _TAGS:
            continue
        name = _TAGS[tag]
        if name in found:
            raise ValueError(f"it has tag {tag} twice")
        form = _TIFF_VALUES[kind]
        (length,) = struct.unpack_from(order + word, data, at + 4)
        if length < 1:
            raise ValueError("its header is damaged")
        value_at = at + entry_bytes - word_bytes
        if length * struct.calcsize(form) > word_bytes:
            (value_at,) = struct.unpack_from(order + word, data, value_at)
        found[name] = struct.unpack_from(
            f"{order}{min(length, _MAX_SAMPLES)}{form}", data, value_at
        )
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
    _PNG_START: _png,
    b"\xff\xd8\xff": _jpeg,
    **dict.fromkeys(_TIFF_STARTS, _tiff),
    b"BM": _bmp,
    b"RIFF": _webp,
    **{b"P%d" % kind: _pnm for kind in range(1, 7)},
}
"""Functions that find the size, by the first bytes of a format."""
