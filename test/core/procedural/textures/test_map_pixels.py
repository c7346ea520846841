"""Maps as their formats define them: bits, gamma, alpha, packed channels, directions of normals."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.output.exr import write_channels
from oaisys_core.procedural.textures import load_texture_folder
from oaisys_core.procedural.textures.normal_maps import decode_normals

SIZE = 32
GREY = np.full((SIZE, SIZE, 3), 90, np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a colour map."""
    save(tmp_path / "a_diff.png", GREY)
    return tmp_path


def save(path: Path, image: NDArray[np.generic]) -> None:
    assert cv2.imwrite(str(path), image)


def bumps() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return heights, 0 to 1, and normals by their closed form: x right, y up in the image."""
    rows, cols = np.mgrid[:SIZE, :SIZE] * 2 * np.pi / SIZE
    height = 0.5 + 0.25 * (np.sin(cols) + np.sin(2 * rows))
    normals = np.stack((-np.cos(cols), 2 * np.cos(2 * rows), np.full_like(rows, 4.0)), axis=-1)
    return height, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@pytest.mark.parametrize("kind", ["floats", "without z", "signed"])
def test_normals_of_other_programs(folder: Path, kind: str) -> None:
    _, normals = bumps()
    if kind == "floats":
        write_channels(folder / "a_nor_gl.exr", _channels((normals + 1) / 2))
    elif kind == "signed":
        write_channels(folder / "a_nor_gl.exr", _channels(normals))
    else:
        save(folder / "a_nor_gl.png", _encoded(normals * (1, 1, 0) - (0, 0, 1)))
    found = decode_normals(load_texture_folder(folder, 1.0).normal_gl)
    np.testing.assert_allclose(found, normals, atol=0.03)


def _channels(image: NDArray[np.float64]) -> dict[str, NDArray[np.float32]]:
    return {name: image[..., at].astype(np.float32) for at, name in enumerate("RGB")}


def _encoded(normals: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint((normals[..., ::-1] + 1) * 127.5).astype(np.uint8)


@pytest.mark.parametrize(
    ("name", "value", "roughness"),
    [
        ("a_rough.png", np.uint16(51 * 257), 51),
        ("a_gloss.png", np.uint16(51 * 257), 204),
        ("a_Smoothness.png", np.uint8(51), 204),
    ],
)
def test_16_bits_and_gloss(folder: Path, name: str, value: np.generic, roughness: int) -> None:
    save(folder / name, np.full((SIZE, SIZE), value))
    assert (load_texture_folder(folder, 1.0).roughness == roughness).all()


@pytest.mark.parametrize(
    ("name", "rgba", "roughness"),
    [
        ("a_ORM.png", (255, 60, 200), 60),
        ("a_OcclusionRoughnessMetallic.png", (255, 60, 200), 60),
        ("a_RMA.png", (60, 200, 255), 60),
        ("a_metallic_roughness.png", (7, 60, 200), 60),
        ("a_MaskMap.png", (200, 255, 7, 195), 60),
        ("a_MetallicSmoothness.png", (200, 0, 7, 195), 60),
        ("a_SpecularSmoothness.png", (200, 0, 7, 195), 60),
        ("a_ordp.tif", (255, 60, 200), 60),
    ],
)
def test_packed_maps_of_other_programs(
    folder: Path, name: str, rgba: tuple[int, ...], roughness: int
) -> None:
    image = np.empty((SIZE, SIZE, len(rgba)), np.uint8)
    image[:] = (*rgba[2::-1], *rgba[3:])
    save(folder / name, image)
    maps = load_texture_folder(folder, 1.0)
    assert (maps.roughness == roughness).all()
    assert (maps.color_srgb == 90).all(), "no occlusion"


def test_heights_of_an_exr_image_beyond_1_keep_their_shape(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    height = bumps()[0].astype(np.float32)
    write_channels(folder / "a_disp.exr", {"R": 4 * height - 2})
    found = load_texture_folder(folder, 1.0).height
    expected = (height - height.min()) / np.ptp(height)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert "a_disp.exr" in caplog.text


@pytest.mark.parametrize(
    "channels",
    [
        {"Y": 0.5, "A": 1.0},
        {"R": 0.5, "G": 0.5, "B": 0.5, "A": 1.0},
        {"R": 0.5, "G": 0.5, "B": 0.5, "sky.R": 0.7, "sky.G": 0.7, "sky.B": 0.7},
        {"rock.V": 0.5, "rock.A": 1.0},
    ],
)
def test_an_exr_map_is_its_colours_or_its_only_channel(
    folder: Path, channels: dict[str, float]
) -> None:
    """Alpha, and the last of several layers, were taken for the map."""
    planes = {name: np.full((SIZE, SIZE), each, np.float32) for name, each in channels.items()}
    write_channels(folder / "a_rough.exr", planes)
    assert (load_texture_folder(folder, 1.0).roughness == 128).all()


@pytest.mark.parametrize("names", [("R", "G"), ("X", "Y", "Z"), ("a.R", "b.R")])
def test_an_exr_map_of_other_channels_is_refused_by_name(
    folder: Path, names: tuple[str, ...]
) -> None:
    plane = np.full((SIZE, SIZE), 0.5, np.float32)
    write_channels(folder / "a_rough.exr", dict.fromkeys(names, plane))
    shown = ", ".join(sorted({name.split(".")[0] for name in names}))
    with pytest.raises(InvalidInputError, match=rf"a_rough\.exr.*not {shown}"):
        load_texture_folder(folder, 1.0)


def test_infinite_heights_are_refused(folder: Path) -> None:
    height = np.full((SIZE, SIZE), np.nan, np.float32)
    write_channels(folder / "a_disp.exr", {"R": height})
    with pytest.raises(InvalidInputError, match=r"a_disp\.exr.*finite"):
        load_texture_folder(folder, 1.0)


def test_a_packed_map_without_its_channel_is_refused(folder: Path) -> None:
    save(folder / "a_MaskMap.png", GREY)
    with pytest.raises(InvalidInputError, match=r"a_MaskMap\.png.*4 channels"):
        load_texture_folder(folder, 1.0)


def test_maps_of_a_download_may_be_in_a_folder_of_their_own(tmp_path: Path) -> None:
    maps = tmp_path / "rock_4k.blend" / "textures"
    maps.mkdir(parents=True)
    save(maps / "rock_diff_4k.jpg", GREY)
    assert load_texture_folder(maps.parent, 1.0).color_srgb.shape == (SIZE, SIZE, 3)


def png_with_gamma(gamma: int, value: int) -> bytes:
    """A PNG image of one grey with a chunk ``gAMA``, by the standard."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    row = b"\0" + bytes([value] * 3 * SIZE)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", SIZE, SIZE, 8, 2, 0, 0, 0))
        + chunk(b"gAMA", struct.pack(">I", gamma))
        + chunk(b"IDAT", zlib.compress(row * SIZE))
        + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize(("gamma", "expected"), [(45455, 55), (100000, 128)])
def test_a_png_says_that_it_is_linear(tmp_path: Path, gamma: int, expected: int) -> None:
    (tmp_path / "a_diff.png").write_bytes(png_with_gamma(gamma, 55))
    # IEC 61966-2-1: 55 / 255 linear is 128 encoded.
    assert (load_texture_folder(tmp_path, 1.0).color_srgb == expected).all()


def test_alpha_and_uneven_sizes_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    save(tmp_path / "a_diff.png", np.full((SIZE, 2 * SIZE, 4), 90, np.uint8))
    save(tmp_path / "a_rough.png", np.full((SIZE // 2, SIZE // 2), 51, np.uint8))
    maps = load_texture_folder(tmp_path, 1.0)
    assert maps.color_srgb.shape == (SIZE, SIZE, 3)
    assert (maps.roughness == 51).all()
    assert "transparency" in caplog.text
    assert f"{2 * SIZE} x {SIZE} pixels become a square tile" in caplog.text
