"""The value that a PNG says is transparent (tRNS): a void of heights, opacity of colours."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.io import MemoryFile

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_headers import png_transparent
from oaisys_core.files.image_formats.image_use import LABEL_IMAGE, MESH_TEXTURE, TEXTURE
from oaisys_core.files.image_formats.images import decode_pixels
from oaisys_core.procedural.meshes.loaded import decode_texture
from oaisys_core.procedural.terrain.dem import import_dem

ROWS, COLS = 6, 8
GREY, RGB = 0, 2


def chunk(name: bytes, data: bytes) -> bytes:
    sum_ = zlib.crc32(name + data)
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", sum_)


def png(values: NDArray[Any], bits: int, transparent: tuple[int, ...] | bytes) -> bytes:
    """Return a PNG of (H, W) grey values or (H, W, 3) colours, with tRNS."""
    kind = GREY if values.ndim == 2 else RGB
    rows = values.reshape(len(values), -1)
    if bits == 16:
        packed = [row.astype(">u2").tobytes() for row in rows]
    else:
        shown = np.unpackbits(rows.astype(np.uint8)[..., None], axis=2)[..., 8 - bits :]
        packed = [np.packbits(row.ravel()).tobytes() for row in shown]
    key = transparent
    if isinstance(key, tuple):
        key = b"".join(struct.pack(">H", value) for value in key)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", COLS, ROWS, bits, kind, 0, 0, 0))
        + chunk(b"gAMA", struct.pack(">I", 45455))
        + chunk(b"tRNS", key)
        + chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row for row in packed)))
        + chunk(b"IEND", b"")
    )


def some(bits: int, channels: int = 1) -> NDArray[Any]:
    shape = (ROWS, COLS) if channels == 1 else (ROWS, COLS, channels)
    return np.random.default_rng(bits).integers(0, 2**bits, shape)


def clear_by_gdal(data: bytes) -> NDArray[np.bool_]:
    with MemoryFile(data) as memory, memory.open() as file:
        return np.asarray(file.dataset_mask() == 0)


@pytest.mark.parametrize("bits", [8, 16])
def test_the_transparent_height_is_a_void(bits: int, tmp_path: Path) -> None:
    heights = np.arange(ROWS * COLS).reshape(ROWS, COLS) + 100
    heights[2:4, 3:5] = 90
    path = tmp_path / "model.png"
    nodata = {"width": COLS, "height": ROWS, "count": 1, "dtype": f"uint{bits}", "nodata": 90}
    with rasterio.open(path, "w", driver="PNG", **nodata) as file:
        file.write(heights.astype(f"uint{bits}"), 1)
    (tmp_path / "model.png.aux.xml").unlink(missing_ok=True)
    found = import_dem(DemConfig(file=path, spacing_m=1.0))
    assert (found.holes, found.filled_px) == (1, 4)
    measured = heights[heights != 90] - np.median(heights[heights != 90])
    assert found.ground.elevation_m.min() == measured.min()


def test_the_transparent_colour_of_a_grey_picture_is_a_void(tmp_path: Path) -> None:
    grey = np.arange(ROWS * COLS).reshape(ROWS, COLS) + 100
    grey[1, 1:4] = 7
    path = tmp_path / "model.png"
    path.write_bytes(png(np.repeat(grey[..., None], 3, axis=2), 8, (7, 7, 7)))
    assert import_dem(DemConfig(file=path, spacing_m=1.0)).filled_px == 3


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
def test_textures_have_the_opacity_of_grey_pictures(bits: int) -> None:
    grey = some(bits)
    data = png(grey, bits, (int(grey[2, 3]),))
    clear = clear_by_gdal(data)
    assert 0 < clear.sum() < clear.size
    for use in (TEXTURE, MESH_TEXTURE):
        pixels = decode_pixels(data, use, "grey.png")
        white = np.iinfo(pixels.dtype).max
        np.testing.assert_array_equal(pixels[..., 3], np.where(clear, 0, white))
        for channel in range(3):
            np.testing.assert_array_equal(pixels[..., channel], grey * (white // (2**bits - 1)))
    colors, alpha = decode_texture(data, "grey.png")
    assert alpha is not None
    np.testing.assert_array_equal(alpha, np.where(clear, 0, 255))
    np.testing.assert_array_equal(colors[..., 0], np.rint(grey * 255 / (2**bits - 1)))


@pytest.mark.parametrize("bits", [8, 16])
def test_textures_have_the_opacity_of_colours(bits: int) -> None:
    colors = some(bits, 3)
    data = png(colors, bits, tuple(colors[4, 5].tolist()))
    clear = clear_by_gdal(data)
    assert clear[4, 5]
    pixels = decode_pixels(data, TEXTURE, "colors.png")
    np.testing.assert_array_equal(pixels[..., 3] == 0, clear)
    np.testing.assert_array_equal(pixels[..., 2::-1], colors)
    _, alpha = decode_texture(data, "colors.png")
    assert alpha is not None
    np.testing.assert_array_equal(alpha, np.where(clear, 0, 255))


@pytest.mark.parametrize("bits", [8, 16])
def test_the_opacity_of_ids_does_not_count(bits: int) -> None:
    ids = some(bits)
    pixels = decode_pixels(png(ids, bits, (int(ids[0, 0]),)), LABEL_IMAGE, "ids.png")
    np.testing.assert_array_equal(pixels, ids)


@pytest.mark.parametrize("damage", [b"", b"\0", b"\0\1\0\2", b"\0\1\0\2\0\3"])
def test_a_damaged_transparent_value_is_refused(damage: bytes) -> None:
    with pytest.raises(InvalidInputError, match="tRNS"):
        decode_pixels(png(some(8), 8, damage), TEXTURE, "grey.png")
    whole = png(some(8), 8, (7,))
    at = whole.index(b"tRNS") + 5
    with pytest.raises(InvalidInputError, match="tRNS"):
        decode_pixels(whole[:at] + b"\x09" + whole[at + 1 :], TEXTURE, "grey.png")


def test_a_picture_without_one_has_none() -> None:
    whole = png(some(8), 8, (7,))
    at = whole.index(b"tRNS") - 4
    assert png_transparent(whole[:at] + whole[at + 14 :]) is None
    assert png_transparent(whole[:30]) is None
