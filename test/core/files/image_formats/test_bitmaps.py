"""Pictures in BMP and in text: as they are stored, or refused by what is not read."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import DENSITY, LABEL_IMAGE, TEXTURE
from oaisys_core.files.image_formats.images import decode_pixels
from oaisys_core.files.image_formats.label_images import read_label_pixels

H, W = 5, 8
RNG = np.random.default_rng(3)
RGB = RNG.integers(0, 256, (H, W, 3), np.uint8)
OPAQUE = np.dstack([RGB, np.full((H, W), 255, np.uint8)])
RGBA_MASKS = struct.pack("<4I", 0xFF, 0xFF00, 0xFF0000, 0xFF000000)


def bmp(pixels: np.ndarray, header: bytes, between: bytes = b"") -> bytes:
    """A file whose rows, from the bottom to the top, have a multiple of four bytes."""
    body = np.ascontiguousarray(pixels[::-1]).tobytes()
    start = 14 + len(header) + len(between)
    return b"BM" + struct.pack("<IHHI", start + len(body), 0, 0, start) + header + between + body


def windows(bits: int, compression: int = 0, size: int = 40, colors: int = 0) -> bytes:
    known = struct.pack("<IiiHHIIiiII", size, W, H, 1, bits, compression, 0, 0, 0, colors, 0)
    masks = RGBA_MASKS if size > 40 else b""
    return (known + masks).ljust(size, b"\0")


def words(red: int, green: int, blue: int) -> np.ndarray:
    """(H, W) pixels of 16 bits, of which the colours have some."""
    r, g, b = (RGB[..., c].astype(np.uint16) >> (8 - n) for c, n in enumerate((red, green, blue)))
    return r << (green + blue) | g << blue | b


BMPS = {
    "24 bits": bmp(RGB[..., ::-1], windows(24)),
    "OS/2, 24 bits": bmp(RGB[..., ::-1], struct.pack("<IHHHH", 12, W, H, 1, 24)),
    "32 bits": bmp(OPAQUE[..., [2, 1, 0, 3]], windows(32)),
    "32 bits with masks, V4": bmp(OPAQUE, windows(32, 3, 108)),
    "palette": bmp(
        np.arange(H * W, dtype=np.uint8).reshape(H, W),
        windows(8, colors=H * W),
        np.dstack([RGB[..., ::-1], np.zeros((H, W), np.uint8)]).tobytes(),
    ),
}


@pytest.mark.parametrize("what", BMPS)
def test_colours_of_bitmaps_are_those_of_the_file(tmp_path: Path, what: str) -> None:
    """OS/2's had grey values."""
    assert np.array_equal(decode_pixels(BMPS[what], TEXTURE, "a")[..., 2::-1], RGB)
    (tmp_path / "a.bmp").write_bytes(BMPS[what])
    red, green, blue = np.moveaxis(RGB.astype(np.int64), -1, 0)
    found = read_label_pixels(tmp_path / "a.bmp", LABEL_IMAGE)
    assert np.array_equal(found.values, red << 16 | green << 8 | blue)


@pytest.mark.parametrize("green", [5, 6])
def test_bitmaps_of_16_bits_are_scaled_to_white(green: int) -> None:
    masks = struct.pack("<3I", 0xF800, 0x7E0, 0x1F) if green == 6 else b""
    data = bmp(words(5, green, 5), windows(16, 3 if masks else 0), masks)
    bits = np.array([5, green, 5])
    shares = (RGB >> (8 - bits)) / (2**bits - 1)
    assert np.abs(decode_pixels(data, TEXTURE, "a")[..., ::-1] / 255 - shares).max() < 1 / 255
    with pytest.raises(InvalidInputError, match="5 bits"):
        decode_pixels(data, LABEL_IMAGE, "a")


def test_bitmaps_with_other_masks_are_refused() -> None:
    """Red and blue were exchanged."""
    data = bmp(OPAQUE, windows(32, 3), RGBA_MASKS)
    for use in (TEXTURE, LABEL_IMAGE, DENSITY):
        with pytest.raises(InvalidInputError, match=rf"{use.field}.*a\.bmp.*bitfields layout"):
            decode_pixels(data, use, "a.bmp")


def test_short_bitmaps_are_refused_in_one_sentence(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InvalidInputError, match="truncated"):
        decode_pixels(BMPS["24 bits"][:-30], TEXTURE, "a.bmp")
    assert capfd.readouterr().err == ""


def text(magic: str, most: int, values: np.ndarray) -> str:
    channels = " ".join(map(str, values.ravel()))
    return f"{magic}\n{W} {H}\n" + (f"{most}\n" if most > 1 else "") + channels


TEXTS = {
    "P1": (text("P1", 1, RGB[..., 0] >> 7), 255 * (1 - (RGB[..., 0] >> 7))),
    "P2": (text("P2", 255, RGB[..., 0]), RGB[..., 0]),
    "P2 of 16 bits": (
        text("P2", 65535, RGB[..., 0] * np.uint16(257)),
        RGB[..., 0] * np.uint16(257),
    ),
    "P3": (text("P3", 255, RGB), RGB),
    "P3 of 16 bits": (text("P3", 65535, RGB * np.uint16(257)), RGB * np.uint16(257)),
}


@pytest.mark.parametrize("end", ["", "\n", " # the end", "\r\n"])
@pytest.mark.parametrize("what", TEXTS)
def test_pictures_in_text_may_end_with_their_last_number(
    capfd: pytest.CaptureFixture[str], what: str, end: str
) -> None:
    """Without a line break, they were called damaged."""
    data, expected = TEXTS[what]
    pixels = decode_pixels((data + end).encode(), TEXTURE, "a")
    assert np.array_equal(pixels[..., ::-1] if pixels.ndim == 3 else pixels, expected)
    with pytest.raises(InvalidInputError, match=r"'a\.ppm'.*that can be read"):
        decode_pixels(data.rpartition(" ")[0].encode(), TEXTURE, "a.ppm")
    assert capfd.readouterr().err == ""
