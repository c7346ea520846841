"""Which colours values stand for: PNG by its third edition, EXR and Radiance by their standards."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.environment.hdri import read_radiance
from oaisys_core.procedural.textures.map_pixels import read_color

SHAPE = (4, 8)
BT2020 = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
RADIANCE = (0.64, 0.33, 0.29, 0.6, 0.15, 0.06, 0.3333, 0.3333)


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(path: Path, value: int, *chunks: bytes) -> Path:
    rows, columns = SHAPE
    row = b"\0" + bytes([value] * 3 * columns)
    header = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    pixels = chunk(b"IDAT", zlib.compress(row * rows))
    parts = (b"\x89PNG\r\n\x1a\n", chunk(b"IHDR", header), *chunks, pixels, chunk(b"IEND", b""))
    path.write_bytes(b"".join(parts))
    return path


def exr(path: Path, channels: dict[str, float], **header: object) -> Path:
    pixels = {name: np.full(SHAPE, value, np.float32) for name, value in channels.items()}
    wanted = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    OpenEXR.File(wanted, pixels).write(str(path))
    return path


def radiance_file(path: Path, primaries: str) -> Path:
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nPRIMARIES={primaries}\n\n-Y 4 +X 8\n"
    path.write_bytes(head.encode() + bytes([128, 64, 32, 129]) * 32)
    return path


PRIMARIES = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06)
GAMMA = b"gAMA"


@pytest.mark.parametrize(
    ("chunks", "expected"),
    [
        ((chunk(GAMMA, struct.pack(">I", 100_000)),), 100 / 255),
        ((chunk(GAMMA, struct.pack(">I", 55_556)),), (100 / 255) ** 1.8),
        ((chunk(GAMMA, struct.pack(">I", 45_455)),), 0.12744),
        ((chunk(b"sRGB", b"\0"), chunk(GAMMA, struct.pack(">I", 100_000))), 0.12744),
        ((chunk(b"cICP", bytes([1, 8, 0, 1])), chunk(b"sRGB", b"\0")), 100 / 255),
        ((chunk(b"cICP", bytes([1, 13, 0, 1])),), 0.12744),
    ],
)
def test_the_light_of_a_png_is_what_its_gamma_says(
    tmp_path: Path, chunks: tuple[bytes, ...], expected: float
) -> None:
    """Skies took all for sRGB, and the ground all but a gamma of 1."""
    file = png(tmp_path / "a.png", 100, *chunks)
    np.testing.assert_allclose(read_radiance(file), expected, rtol=1e-3)
    shown = read_color(file)
    np.testing.assert_allclose(((shown + 0.055) / 1.055) ** 2.4, expected, rtol=1e-3)


@pytest.mark.parametrize(
    "extra",
    [
        chunk(b"cICP", bytes([9, 16, 0, 1])),
        chunk(b"cHRM", struct.pack(">8I", 31270, 32900, *(int(1e5 * v) for v in BT2020[:6]))),
        chunk(b"iCCP", b"other\0\0" + zlib.compress(b"Display P3".rjust(200))),
    ],
    ids=["cICP", "cHRM", "iCCP"],
)
def test_other_colours_than_those_of_srgb_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, extra: bytes
) -> None:
    file = png(tmp_path / "a.png", 100, extra)
    for read in (read_radiance, read_color):
        caplog.clear()
        read(file)
        assert "save it as sRGB" in caplog.text


@pytest.mark.parametrize("primaries", [BT2020, ACES])
def test_primaries_other_than_those_of_srgb_are_refused(
    tmp_path: Path, primaries: tuple[float, ...]
) -> None:
    """They were taken for those of sRGB."""
    colors = {"R": 0.6, "G": 0.3, "B": 0.1}
    file = exr(tmp_path / "a.exr", colors, chromaticities=primaries)
    other = radiance_file(tmp_path / "a.hdr", " ".join(map(str, primaries)))
    for read, path in ((read_radiance, file), (read_color, file), (read_radiance, other)):
        with pytest.raises(InvalidInputError, match=rf"primaries of sRGB.*not {primaries[0]:g}, "):
            read(path)


@pytest.mark.parametrize("text", ["0.64 0.33", "red", ""])
def test_primaries_that_are_none_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InvalidInputError, match=f"its header says 'PRIMARIES={text}'"):
        read_radiance(radiance_file(tmp_path / "a.hdr", text))


def test_primaries_of_radiance_and_srgb_are_read(tmp_path: Path) -> None:
    file = radiance_file(tmp_path / "a.hdr", " ".join(map(str, RADIANCE)))
    np.testing.assert_array_equal(read_radiance(file)[0, 0], (1.0, 0.5, 0.25))
    colors = {"R": 0.6, "G": 0.3, "B": 0.1}
    file = exr(tmp_path / "a.exr", colors, chromaticities=(*PRIMARIES, 0.3127, 0.329))
    np.testing.assert_allclose(read_radiance(file)[0, 0], (0.6, 0.3, 0.1), rtol=1e-6)


def test_colours_of_exr_textures_are_divided_by_their_opacity(tmp_path: Path) -> None:
    """OpenEXR's standard: colours are multiplied by it. They were read as dark as that."""
    file = exr(tmp_path / "a.exr", {"R": 0.3, "G": 0.15, "B": 0.05, "A": 0.5})
    shown = read_color(file)[0, 0]
    np.testing.assert_allclose(((shown + 0.055) / 1.055) ** 2.4, (0.6, 0.3, 0.1), rtol=1e-4)
