"""Images whose pixels are ids or heights: as they are stored, or refused by their bits."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image
from rasterio.io import MemoryFile

from oaisys_core.config.sections.environment import HdriImageConfig
from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import (
    DENSITY,
    ELEVATION,
    LABEL_IMAGE,
    SKY_LABELS,
    TEXTURE,
    ImageUse,
)
from oaisys_core.files.image_formats.images import decode_pixels
from oaisys_core.files.image_formats.label_images import read_label_pixels
from oaisys_core.procedural.environment.hdri import SkyImages
from oaisys_core.procedural.terrain.dem import import_dem
from oaisys_core.procedural.textures.label_image import load_label_image

VALUES = np.arange(32, dtype=np.uint16).reshape(4, 8)


def png(bits: int, kind: int = 0) -> bytes:
    """Values that count up to the largest; kind 3 has a palette of eight reds."""

    def chunk(name: bytes, data: bytes) -> bytes:
        sum_ = struct.pack(">I", zlib.crc32(name + data))
        return struct.pack(">I", len(data)) + name + data + sum_

    bytes_of = (VALUES.astype(int) % 2**bits).astype(">u2" if bits == 16 else "u1").tobytes()
    numbers = np.unpackbits(np.frombuffer(bytes_of, np.uint8)).reshape(VALUES.size, -1)
    rows = np.packbits(numbers[:, -bits:].reshape(len(VALUES), -1), axis=1)
    body = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows))
    palette = bytes(np.array([[200 + n, 0, 0] for n in range(2 ** min(bits, 3))], np.uint8))
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 8, 4, bits, kind, 0, 0, 0))
    more = chunk(b"PLTE", palette) if kind == 3 else b""
    return b"\x89PNG\r\n\x1a\n" + head + more + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def tiff(bits: int, **more: Any) -> bytes:
    size = {"width": 8, "height": 4, "count": 1, "dtype": "uint16" if bits > 8 else "uint8"}
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", nbits=bits, **size, **more) as file:
            file.write((VALUES.astype(int) % 2**bits).astype(size["dtype"]), 1)
        return bytes(memory.getbuffer())


def pnm(magic: str, most: int) -> bytes:
    head = f"{magic}\n# somebody's\n8 4\n{most}\n".encode()
    values = VALUES.astype(int) % (most + 1)
    if magic == "P2":
        return head + " ".join(map(str, values.ravel())).encode() + b"\n"
    return head + values.astype(">u2" if most > 255 else "u1").tobytes()


def bmp(bits: int) -> bytes:
    data = bytearray(cv2.imencode(".bmp", np.zeros((4, 8, 3), np.uint8))[1].tobytes())
    data[28:30] = struct.pack("<H", bits)
    return bytes(data)


ODD: dict[str, tuple[Callable[[], bytes], str]] = {
    **{f"PNG {bits}": (partial(png, bits), f"{bits} bits") for bits in (1, 2, 4)},
    **{f"TIFF {bits}": (partial(tiff, bits), f"{bits} bits") for bits in (1, 4, 10, 12)},
    **{f"P2 {most}": (partial(pnm, "P2", most), f"not {most} ") for most in (15, 200)},
    **{f"P5 {most}": (partial(pnm, "P5", most), f"not {most} ") for most in (15, 4095)},
    "P4": (lambda: b"P4\n8 4\n\1\2\3\4", "1 bits"),
    "BMP 16": (lambda: bmp(16), "5 bits"),
    "TIFF white 0": (lambda: tiff(8, photometric="MINISWHITE"), "MinIsWhite"),
    "TIFF white 0, 16 bits": (lambda: tiff(16, photometric="MINISWHITE"), "MinIsWhite"),
}
EXACT: dict[str, Callable[[], bytes]] = {
    "PNG 8": lambda: png(8),
    "PNG 16": lambda: png(16),
    "TIFF 8": lambda: tiff(8),
    "TIFF 16": lambda: tiff(16),
    "P2 255": lambda: pnm("P2", 255),
    "P5 65535": lambda: pnm("P5", 65535),
}


@pytest.mark.parametrize("use", [LABEL_IMAGE, SKY_LABELS, ELEVATION], ids=lambda use: use.name)
@pytest.mark.parametrize("what", ODD)
def test_values_that_a_decoder_changes_are_refused_by_their_bits(use: ImageUse, what: str) -> None:
    """A label image of four bits had 17 times its ids."""
    make, said = ODD[what]
    with pytest.raises(InvalidInputError, match=rf"{use.field}: received 'a\.png'.*{said}"):
        decode_pixels(make(), use, "a.png")


@pytest.mark.parametrize("use", [LABEL_IMAGE, SKY_LABELS, ELEVATION], ids=lambda use: use.name)
@pytest.mark.parametrize("what", EXACT)
def test_values_of_8_and_16_bits_are_those_of_the_file(use: ImageUse, what: str) -> None:
    assert (decode_pixels(EXACT[what](), use, "a") == VALUES).all()


@pytest.mark.parametrize("use", [TEXTURE, DENSITY], ids=lambda use: use.name)
def test_shares_of_white_are_scaled_or_refused(use: ImageUse) -> None:
    for bits in (1, 2, 4):
        expected = VALUES % 2**bits * 255 // (2**bits - 1)
        assert (decode_pixels(png(bits), use, "a") == expected).all()
    for data in (pnm("P5", 15), pnm("P5", 4095), pnm("P2", 4095), pnm("P2", 15)):
        with pytest.raises(InvalidInputError, match=r"not \d+ \(\d+ bits"):
            decode_pixels(data, use, "a")
    with pytest.raises(InvalidInputError, match="MinIsWhite"):
        decode_pixels(tiff(16, photometric="MINISWHITE"), use, "a")


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_a_palette_is_its_colours(tmp_path: Path, bits: int) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(bits, kind=3))
    if bits == 8:  # beyond the palette
        image = Image.fromarray((VALUES % 8).astype(np.uint8)).convert("P")
        image.putpalette([each for n in range(8) for each in (200 + n, 0, 0)])
        image.save(path)
    pixels = read_label_pixels(path, LABEL_IMAGE)
    assert pixels.is_color
    if bits < 4:
        assert (pixels.where("#c90000") == (VALUES % 2**bits == 1)).all()


@pytest.mark.parametrize("channels", [3, 4])
def test_colours_of_16_bits_are_refused(tmp_path: Path, channels: int) -> None:
    """Their channels overlapped: several colours had one number."""
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.ones((4, 8, channels), np.uint16))
    for use in (LABEL_IMAGE, SKY_LABELS):
        with pytest.raises(InvalidInputError, match=rf"not {channels} channels of 16 bits"):
            read_label_pixels(path, use)


def test_labels_of_the_ground_are_refused_by_their_bits(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png(4))
    with pytest.raises(InvalidInputError, match=r"labels_from.*a\.png.*4 bits"):
        load_label_image(tmp_path / "a.png", {"1": (6,)}, (1,))


def test_heights_of_fewer_bits_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png(4))
    with pytest.raises(InvalidInputError, match=r"stage\.dem\.file.*4 bits"):
        import_dem(DemConfig(file=tmp_path / "a.png", spacing_m=1.0))


def sky(folder: Path, labels: np.ndarray | bytes, **mapping: int) -> np.ndarray:
    """Ids of a sky's label image."""
    cv2.imwrite(str(folder / "sky.hdr"), np.ones((4, 8, 3), np.float32))
    data = labels if isinstance(labels, bytes) else cv2.imencode(".png", labels)[1].tobytes()
    (folder / "labels.png").write_bytes(data)
    ids = {key: {"label": f"a{each}", "semantic_id": each} for key, each in mapping.items()}
    labels_from = [{"image": folder / "labels.png", "mapping": ids}]
    config = HdriImageConfig.model_validate(
        {"file": folder / "sky.hdr", "labels_from": labels_from}
    )
    (_, found), *_ = SkyImages().load(config, (1,)).label_maps
    return np.asarray(found)


def test_labels_of_a_sky_are_grey_or_colours(tmp_path: Path) -> None:
    """A grey value of the mapping was never found in an image of three channels."""
    grey = (VALUES % 3).astype(np.uint8)
    for image in (grey, np.dstack([grey] * 3), grey.astype(np.uint16)):
        assert (sky(tmp_path, image, **{"2": 9}) == np.where(grey == 2, 9, 1)).all()
        assert (sky(tmp_path, image, **{"#020202": 9}) == np.where(grey == 2, 9, 1)).all()
        with pytest.raises(InvalidInputError, match=r"hdri\.labels_from.*values of the mapping"):
            sky(tmp_path, image, **{"#020000": 9})
    with pytest.raises(InvalidInputError, match=r"hdri\.labels_from.*labels\.png.*2 bits"):
        sky(tmp_path, png(2), **{"2": 9})
    floats = io.BytesIO()
    Image.fromarray(np.ones((4, 8), np.float32)).save(floats, "TIFF")
    with pytest.raises(InvalidInputError, match=r"hdri\.labels_from.*32 bits"):
        sky(tmp_path, floats.getvalue(), **{"1": 9})
