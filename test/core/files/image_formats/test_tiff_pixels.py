"""Pictures in TIFF: what was written, as textures, labels and textures of meshes, or refused."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rasterio.io import MemoryFile

from oaisys_core.color import srgb
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import (
    DENSITY,
    LABEL_IMAGE,
    MESH_TEXTURE,
    SKY,
    SKY_LABELS,
    TEXTURE,
    ImageUse,
)
from oaisys_core.files.image_formats.images import decode_pixels
from oaisys_core.files.image_formats.label_images import read_label_pixels
from oaisys_core.procedural.meshes.loaded import decode_texture
from oaisys_core.procedural.textures.map_pixels import read_color, read_map

H, W = 40, 48
RNG = np.random.default_rng(7)
RGB8 = RNG.integers(0, 256, (3, H, W), np.uint8)
RGB16 = RNG.integers(0, 65536, (3, H, W), np.uint16)
FLOATS = RNG.random((3, H, W), np.float32)
TILES = {"tiled": True, "blockxsize": 16, "blockysize": 16}
LAYOUTS: dict[str, dict[str, Any]] = {
    "pixels": {"interleave": "pixel"},
    "planes": {"interleave": "band"},
    "tiles": {"interleave": "pixel", **TILES},
    "tiles of planes": {"interleave": "band", **TILES},
    "planes, deflate": {"interleave": "band", "compress": "deflate"},
    "planes, big-endian": {"interleave": "band", "ENDIANNESS": "BIG"},
    "planes, BigTIFF": {"interleave": "band", "BIGTIFF": "YES"},
    "one strip": {"interleave": "pixel", "blockysize": H},
}


def tiff(planes: np.ndarray, **more: Any) -> bytes:
    """A file of (C, H, W) planes, or of (H, W) values."""
    planes = planes[None] if planes.ndim == 2 else planes
    shape = dict(zip(("count", "height", "width"), planes.shape, strict=True))
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", dtype=planes.dtype, **shape, **more) as file:
            file.write(planes)
        return bytes(memory.getbuffer())


def tiff_of_pillow(pixels: np.ndarray, mode: str | None = None, **more: Any) -> bytes:
    image = Image.fromarray(pixels)
    stream = io.BytesIO()
    (image if mode is None else image.convert(mode)).save(stream, "TIFF", **more)
    return stream.getvalue()


def as_bytes(shares: np.ndarray) -> np.ndarray:
    """(H, W, C) shares of (C, H, W) planes as bytes."""
    return np.rint(255 * np.moveaxis(shares, 0, -1)).astype(np.uint8)


def saved(folder: Path, data: bytes) -> Path:
    (folder / "a_diff.tif").write_bytes(data)
    return folder / "a_diff.tif"


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("planes", [RGB8, RGB16, FLOATS], ids=lambda planes: str(planes.dtype))
def test_colours_are_those_of_the_file_in_each_layout(
    tmp_path: Path, planes: np.ndarray, layout: str
) -> None:
    """Planes of 16 bits and floats were garbage."""
    predictors = (1, 3) if planes.dtype.kind == "f" else (1, 2)
    is_compressed = "compress" in LAYOUTS[layout]
    largest = 1 if planes.dtype.kind == "f" else np.iinfo(planes.dtype).max
    shares = planes / np.float32(largest)
    for predictor in predictors if is_compressed else (1,):
        options = {"predictor": predictor} if is_compressed else {}
        data = tiff(planes, photometric="RGB", **LAYOUTS[layout], **options)
        pixels, gamma = read_map(saved(tmp_path, data))
        assert np.array_equal(pixels, np.moveaxis(shares, 0, -1))
        is_linear = largest == 1
        assert gamma == (1.0 if is_linear else None)
        colors, alpha = decode_texture(data, "a.tif")
        expected = as_bytes(srgb(shares) if is_linear else shares)
        assert np.array_equal(colors, expected)
        assert alpha is None


@pytest.mark.parametrize("layout", ["pixels", "planes", "tiles of planes"])
@pytest.mark.parametrize("kind", ["RGB", "MINISBLACK"])
@pytest.mark.parametrize("is_wide", [False, True], ids=["8 bits", "16 bits"])
def test_colours_are_not_multiplied_by_opacity(
    tmp_path: Path, is_wide: bool, kind: str, layout: str
) -> None:
    """Labels and textures under an opacity of a half had half their values."""
    color = RGB16 if is_wide else RGB8
    planes = color if kind == "RGB" else color[:1]
    largest = np.iinfo(color.dtype).max
    opacity = RNG.integers(0, largest, (1, H, W), color.dtype, endpoint=True)
    data = tiff(np.concatenate([planes, opacity]), photometric=kind, alpha="YES", **LAYOUTS[layout])
    shares = np.broadcast_to(planes, (3, H, W)) / np.float32(largest)
    pixels, _ = read_map(saved(tmp_path, data))
    assert np.array_equal(pixels[..., :3], np.moveaxis(shares, 0, -1))
    assert np.array_equal(pixels[..., 3], opacity[0] / np.float32(largest))
    colors, alpha = decode_texture(data, "a.tif")
    assert np.array_equal(colors, as_bytes(shares))
    assert alpha is not None
    assert np.array_equal(alpha, as_bytes(opacity / largest)[..., 0])
    if kind == "MINISBLACK":
        found = read_label_pixels(saved(tmp_path, data), LABEL_IMAGE)
        assert not found.is_color
        assert np.array_equal(found.values, planes[0])
    elif not is_wide:
        red, green, blue = planes.astype(np.int64)
        found = read_label_pixels(saved(tmp_path, data), LABEL_IMAGE)
        assert np.array_equal(found.values, red << 16 | green << 8 | blue)


def test_ids_of_16_bits_with_opacity_are_those_of_the_file(tmp_path: Path) -> None:
    """1000 and 1001 were both 3."""
    ids = np.array([[1000, 1001], [1, 65535]], np.uint16)
    data = tiff(np.stack([ids, ids]), photometric="MINISBLACK", alpha="YES")
    for use in (LABEL_IMAGE, SKY_LABELS):
        found = read_label_pixels(saved(tmp_path, data), use)
        assert np.array_equal(found.values, ids)
        assert found.where("1000").sum() == 1


def test_colours_multiplied_by_opacity_are_divided_by_it_or_refused_as_ids(tmp_path: Path) -> None:
    """TIFF's associated alpha, which Pillow divides likewise."""
    opacity = np.full((H, W, 1), 128, np.uint8)
    opacity[:4] = 0
    stored = np.minimum(np.moveaxis(RGB8, 0, -1), opacity)
    planes = np.moveaxis(np.concatenate([stored, opacity], axis=2), -1, 0)
    data = tiff(planes, photometric="RGB", alpha="PREMULTIPLIED", interleave="pixel")
    colors, alpha = decode_texture(data, "a.tif")
    with Image.open(io.BytesIO(data)) as image:
        assert image.mode == "RGBA"
        expected = np.asarray(image)
    assert alpha is not None
    assert np.array_equal(alpha, expected[..., 3])
    shown = alpha > 0
    assert np.abs(colors[shown].astype(int) - expected[shown][:, :3]).max() <= 1
    assert not colors[~shown].any()
    with pytest.raises(InvalidInputError, match=r"labels_from.*associated alpha"):
        read_label_pixels(saved(tmp_path, data), LABEL_IMAGE)
    planes[3] = 255
    data = tiff(planes, photometric="RGB", alpha="PREMULTIPLIED", interleave="pixel")
    assert read_label_pixels(saved(tmp_path, data), LABEL_IMAGE).is_color


def test_a_channel_of_no_known_meaning_is_no_opacity(tmp_path: Path) -> None:
    planes = np.concatenate([RGB8, RGB8[:1]])
    data = tiff(planes, photometric="RGB", alpha="NO", interleave="pixel")
    assert decode_texture(data, "a.tif")[1] is None
    assert np.array_equal(read_map(saved(tmp_path, data))[0][..., 3], RGB8[0] / np.float32(255))


@pytest.mark.parametrize(
    "dtype", ["int8", "int16", "int32", "uint32", "int64", "uint64", "float64"]
)
@pytest.mark.parametrize("use", [TEXTURE, MESH_TEXTURE, DENSITY, SKY, LABEL_IMAGE, SKY_LABELS])
def test_values_of_other_types_are_refused_by_their_type(use: ImageUse, dtype: str) -> None:
    """As textures of meshes, they were nonsense."""
    data = tiff(np.ones((4, 8), dtype))
    bits = f"{8 * np.dtype(dtype).itemsize} bits"
    with pytest.raises(InvalidInputError, match=rf"{use.field}.*'a\.tif'.*not.*({dtype}|{bits})"):
        decode_pixels(data, use, "a.tif")


@pytest.mark.parametrize("bits", [1, 2, 4, 10, 12, 14])
def test_values_of_other_bits_are_scaled(tmp_path: Path, bits: int) -> None:
    """As textures of meshes, those of 12 bits were 16 times too dark."""
    values = (RGB16[0] >> (16 - bits)).astype(np.uint8 if bits <= 8 else np.uint16)
    data = tiff(values, nbits=bits)
    shares = values / (2**bits - 1)
    pixels, _ = read_map(saved(tmp_path, data))
    assert np.abs(pixels - shares[..., None]).max() < 1e-5
    colors, _ = decode_texture(data, "a.tif")
    assert np.abs(colors / 255 - shares[..., None]).max() <= 0.5 / 255 + 1e-5


def test_half_floats_and_grey_floats_are_linear(tmp_path: Path) -> None:
    values = np.linspace(0, 1, H * W, dtype=np.float32).reshape(H, W)
    for more in ({}, {"nbits": 16}):
        data = tiff(values, **more)
        expected = np.repeat(srgb(values)[..., None], 3, axis=2)
        assert np.abs(read_color(saved(tmp_path, data)) - expected).max() < 1e-3
        colors, _ = decode_texture(data, "a.tif")
        assert np.abs(colors / 255 - expected).max() < 0.5 / 255 + 1e-3
    with pytest.raises(InvalidInputError, match="finite"):
        decode_texture(tiff(np.full((4, 8), np.nan, np.float32)), "a.tif")


@pytest.mark.parametrize("turn", range(1, 9))
def test_pictures_are_turned_as_pillow_turns_them(tmp_path: Path, turn: int) -> None:
    data = tiff_of_pillow(np.moveaxis(RGB8, 0, -1), tiffinfo={274: turn})
    with Image.open(io.BytesIO(data)) as image:
        image.load()
        expected = np.asarray(image)
    assert np.array_equal(decode_pixels(data, TEXTURE, "a")[..., ::-1], expected)
    assert np.array_equal(decode_texture(data, "a")[0], expected)


@pytest.mark.parametrize("mode", ["CMYK", "YCbCr", "P", "1", "L"])
def test_colours_of_other_kinds_are_as_of_pillow(tmp_path: Path, mode: str) -> None:
    data = tiff_of_pillow(np.moveaxis(RGB8, 0, -1), mode)
    with Image.open(io.BytesIO(data)) as image:
        expected = np.asarray(image.convert("RGB"), int)
    colors, alpha = decode_texture(data, "a")
    assert np.abs(colors - expected).max() <= 1
    assert alpha is None
    if mode in ("CMYK", "YCbCr"):
        with pytest.raises(InvalidInputError, match="as RGB, not CMYK or YCbCr"):
            read_label_pixels(saved(tmp_path, data), LABEL_IMAGE)


def test_colours_of_unknown_kinds_are_refused_by_their_number() -> None:
    lab = tiff_of_pillow(np.moveaxis(RGB8, 0, -1), "LAB")
    wide = tiff(np.concatenate([RGB16, RGB16[:1]]), photometric="CMYK", interleave="pixel")
    for use in (TEXTURE, MESH_TEXTURE, LABEL_IMAGE):
        with pytest.raises(InvalidInputError, match="photometric interpretation 8"):
            decode_pixels(lab, use, "a.tif")
        with pytest.raises(InvalidInputError, match="of 16 bits"):
            decode_pixels(wide, use, "a.tif")


def test_three_channels_that_are_called_grey_are_colours_but_not_ids(tmp_path: Path) -> None:
    """As rasterio writes an array of 16 bits."""
    data = tiff(RGB16)
    expected = np.moveaxis(RGB16, 0, -1) / np.float32(65535)
    assert np.array_equal(read_map(saved(tmp_path, data))[0], expected)
    with pytest.raises(InvalidInputError, match="3 channels are colours"):
        read_label_pixels(saved(tmp_path, data), LABEL_IMAGE)


def test_a_header_of_different_bits_is_refused() -> None:
    data = bytearray(tiff(RGB8, photometric="RGB", interleave="pixel"))
    place = data.index(struct.pack("<3H", 8, 8, 8))
    data[place : place + 6] = struct.pack("<3H", 8, 8, 16)
    with pytest.raises(InvalidInputError, match="different bits: 8, 8, 16"):
        decode_pixels(bytes(data), TEXTURE, "a.tif")


@pytest.mark.parametrize("layout", ["pixels", "planes, deflate"])
def test_damaged_pixels_are_refused_in_one_sentence(
    capfd: pytest.CaptureFixture[str], layout: str
) -> None:
    data = tiff(RGB16, photometric="RGB", **LAYOUTS[layout])
    with pytest.raises(InvalidInputError, match=r"'a\.tif'.*that can be read"):
        decode_pixels(data[: len(data) * 3 // 4], TEXTURE, "a.tif")
    assert capfd.readouterr().err == ""


def test_a_picture_in_one_strip_may_be_as_large_as_the_bound() -> None:
    use = ImageUse("a test", H * W, "file")
    for planes in (RGB8, np.concatenate([RGB8, RGB8[:1]])):
        data = tiff(planes, photometric="RGB", **LAYOUTS["one strip"])
        assert decode_pixels(data, use, "a.tif").shape == (H, W, len(planes))
    with pytest.raises(InvalidInputError, match=f"at most {H * W} pixels, not {W} x {H + 1}"):
        decode_pixels(tiff(np.zeros((3, H + 1, W), np.uint8), photometric="RGB"), use, "a.tif")


def test_densities_are_grey_values(tmp_path: Path) -> None:
    import cv2

    grey = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE
    data = tiff(np.stack([RGB16[0], RGB16[1]]), photometric="MINISBLACK", alpha="YES")
    assert np.array_equal(decode_pixels(data, DENSITY, "a", grey), RGB16[0])
    data = tiff(RGB8, photometric="RGB", interleave="band")
    expected = np.tensordot([0.299, 0.587, 0.114], RGB8, 1)
    assert np.abs(decode_pixels(data, DENSITY, "a", grey) - expected).max() < 1
