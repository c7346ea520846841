"""Images of data sets decoded without OpenCV and GDAL: the same pixels, and no others."""

from __future__ import annotations

import io
import struct
import zlib
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from oaisys_core.errors import InvalidInputError
from oaisys_core.output import tiff
from oaisys_core.output.images import encode_image
from oaisys_core.output.plain_images import PNG_HEAD, decode_png, decode_tiff

RNG = np.random.default_rng(5)


def filtered_png(pixels: NDArray[np.uint8], filters: list[int]) -> bytes:
    """Return an RGB PNG whose rows have given filters, written by the rules of its standard."""
    height, width, _ = pixels.shape
    rows, above = [], np.zeros(width * 3, int)
    for kind, line in zip(filters, pixels.reshape(height, -1).astype(int), strict=True):
        left = np.concatenate((np.zeros(3, int), line[:-3]))
        corner = np.concatenate((np.zeros(3, int), above[:-3]))
        estimate = left + above - corner
        options = np.stack((left, above, corner))
        nearest = np.abs(estimate - options).argmin(axis=0)
        paeth = np.take_along_axis(options, nearest[None], axis=0)[0]
        guess = (0, left, above, (left + above) // 2, paeth)[kind]
        rows.append(bytes([kind]) + ((line - guess) % 256).astype(np.uint8).tobytes())
        above = line

    def chunk(name: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(b"".join(rows))
    return PNG_HEAD + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (48, 64), (48, 64, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_files_of_opencv_have_their_pixels(shape: tuple[int, ...], dtype: type) -> None:
    pixels: NDArray[Any] = RNG.integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)
    found = decode_png(encode_image(pixels), "x.png")
    assert found.dtype == dtype
    assert np.array_equal(found, pixels)


def test_png_files_of_pillow_and_with_any_filters_have_their_pixels() -> None:
    pixels = np.cumsum(RNG.integers(0, 9, (20, 30, 3)), axis=0).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    assert np.array_equal(decode_png(file.getvalue(), "x.png"), pixels)
    data = filtered_png(pixels, [kind % 5 for kind in range(20)])
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(data))), pixels)
    assert np.array_equal(decode_png(data, "x.png"), pixels)


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_tiff_files_of_shards_have_their_pixels(channels: int) -> None:
    pixels = RNG.normal(size=(37, 41, channels)).astype(np.float32)
    pixels[3, 4] = np.inf
    pixels[5, 6] = np.nan
    pixels = pixels[..., 0] if channels == 1 else pixels
    found = decode_tiff(tiff.encode_floats(pixels), "x.tif")
    assert found.tobytes() == pixels.tobytes()
    assert found.shape == pixels.shape


@pytest.mark.parametrize(
    "options",
    [
        {"compress": "deflate"},
        {"compress": "deflate", "predictor": 2},
        {"compress": "zstd", "blockysize": 5},
        {},
    ],
)
def test_tiff_files_of_ids_have_their_pixels(options: dict[str, object]) -> None:
    pixels = RNG.integers(0, 1 << 31, (37, 41)).astype(np.uint32)
    found = decode_tiff(tiff.encode(pixels, **options), "x.tif")
    assert np.array_equal(found, pixels)
    assert found.dtype == np.uint32


def test_planes_that_are_apart_are_joined() -> None:
    pixels = RNG.normal(size=(16, 9, 3)).astype(np.float32)
    file = tiff.encode(pixels, compress="deflate", interleave="band")
    assert np.array_equal(decode_tiff(file, "x.tif"), pixels)


def test_files_that_are_cut_changed_or_too_large_are_refused() -> None:
    pixels = RNG.normal(size=(30, 40)).astype(np.float32)
    images = (
        (decode_png, encode_image(RNG.integers(0, 256, (30, 40)).astype(np.uint8))),
        (decode_tiff, tiff.encode_floats(pixels)),
    )
    for decode, file in images:
        for cut in range(0, len(file) - 1, 7):
            with pytest.raises(InvalidInputError):
                decode(file[:cut], "x")
        for place in range(0, len(file), 11):
            changed = bytearray(file)
            changed[place] ^= 0xFF
            try:
                decode(bytes(changed), "x")
            except InvalidInputError:
                continue
    large = struct.pack(">I4sIIBBBBB", 13, b"IHDR", 1 << 20, 1 << 20, 8, 2, 0, 0, 0)
    checksum = struct.pack(">I", zlib.crc32(large[4:]))
    end = struct.pack(">I4sI", 0, b"IEND", zlib.crc32(b"IEND"))
    with pytest.raises(InvalidInputError, match="at most"):
        decode_png(PNG_HEAD + large + checksum + end, "x.png")
