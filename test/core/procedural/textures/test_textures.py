"""Texture sets: made, cached, read from folders."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.output.exr import GREY, write_channels
from oaisys_core.procedural.textures import (
    TEXTURES,
    default_cache_dir,
    load_texture_folder,
    texture_set,
)
from oaisys_core.procedural.textures.fields import normals_from_height
from oaisys_core.scene import PbrMaps

SIZE = 96


def arrays(maps: PbrMaps) -> list[bytes]:
    return [m.tobytes() for m in (maps.color_srgb, maps.height, maps.normal_gl, maps.roughness)]


@pytest.fixture(scope="module")
def made() -> dict[str, PbrMaps]:
    return {name: texture_set(name, SIZE, 0, None) for name in sorted(TEXTURES)}


@pytest.mark.parametrize("name", sorted(TEXTURES))
def test_maps_have_their_types_and_ranges(made: dict[str, PbrMaps], name: str) -> None:
    maps = made[name]
    assert (maps.color_srgb.shape, maps.color_srgb.dtype) == ((SIZE, SIZE, 3), np.uint8)
    assert (maps.height.shape, maps.height.dtype) == ((SIZE, SIZE), np.float32)
    assert (maps.height.min(), maps.height.max()) == (0.0, 1.0)
    assert (maps.roughness.shape, maps.roughness.dtype) == ((SIZE, SIZE), np.uint8)
    normal = (maps.normal_gl.astype(float) - 128) / 127
    assert np.allclose(np.linalg.norm(normal, axis=-1), 1, atol=0.02)
    assert maps.tile_m > 0.5


@pytest.mark.parametrize("name", sorted(TEXTURES))
def test_maps_tile_without_a_seam(made: dict[str, PbrMaps], name: str) -> None:
    color = made[name].color_srgb.astype(float).mean(axis=-1)
    for axis in (0, 1):
        inside = np.abs(np.diff(color, axis=axis)).mean()
        seam = np.abs(color.take(0, axis) - color.take(-1, axis)).mean()
        assert seam < 1.5 * inside


@pytest.mark.parametrize("name", sorted(TEXTURES))
def test_a_seed_decides(made: dict[str, PbrMaps], name: str) -> None:
    assert arrays(texture_set(name, SIZE, 0, None)) == arrays(made[name])
    assert arrays(texture_set(name, SIZE, 1, None)) != arrays(made[name])


def test_the_cache_gives_back_what_was_made(made: dict[str, PbrMaps], tmp_path: Path) -> None:
    assert arrays(texture_set("sand", SIZE, 0, tmp_path)) == arrays(made["sand"])
    (file,) = tmp_path.iterdir()
    written = file.stat().st_ino
    assert arrays(texture_set("sand", SIZE, 0, tmp_path)) == arrays(made["sand"])
    assert file.stat().st_ino == written
    file.write_bytes(b"cut short")
    assert arrays(texture_set("sand", SIZE, 0, tmp_path)) == arrays(made["sand"])


def test_the_cache_follows_xdg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_cache_dir() == tmp_path / "oaisys" / "textures"
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert default_cache_dir() is None


def test_unknown_names_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="gravel"):
        texture_set("velvet", SIZE, 0, None)


def test_normals_lean_away_from_a_slope() -> None:
    # A bump: its right flank looks right (red up), its upper flank looks up (green up, OpenGL).
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    bump = np.exp(-8 * (x**2 + y**2)).astype(np.float32)
    normal = normals_from_height(bump, 0.3, 1.0).astype(int) - 128
    assert normal[32, 44, 0] > 30
    assert normal[32, 20, 0] < -30
    assert normal[20, 32, 1] > 30
    assert normal[44, 32, 1] < -30


def write_folder(folder: Path, names: dict[str, np.ndarray]) -> None:
    for name, image in names.items():
        assert cv2.imwrite(str(folder / name), image)


def test_a_poly_haven_folder_is_read(tmp_path: Path) -> None:
    color = np.zeros((32, 32, 3), np.uint8)
    color[:] = (10, 120, 200)
    normal = np.zeros((32, 32, 3), np.uint8)
    normal[:] = (255, 128, 128)
    write_folder(
        tmp_path,
        {
            "rocky_ground_diff_1k.png": color,
            "rocky_ground_disp_1k.png": np.full((32, 32), 65535 // 4, np.uint16),
            "rocky_ground_nor_gl_1k.png": normal,
            "rocky_ground_nor_dx_1k.png": normal[..., ::-1],
            "rocky_ground_rough_1k.png": np.full((32, 32), 51, np.uint8),
        },
    )
    maps = load_texture_folder(tmp_path, 2.5)
    assert maps.tile_m == 2.5
    assert (maps.color_srgb == (200, 120, 10)).all()
    assert np.allclose(maps.height, 0.25, atol=1e-4)
    assert (maps.normal_gl == (128, 128, 255)).all()
    assert (maps.roughness == 51).all()
    assert load_texture_folder(tmp_path, 2.5, size_px=16).color_srgb.shape == (16, 16, 3)


def test_only_the_colour_map_must_be_there(tmp_path: Path) -> None:
    write_folder(tmp_path, {"Ground_BaseColor.jpg": np.full((16, 16, 3), 90, np.uint8)})
    maps = load_texture_folder(tmp_path, 1.0)
    assert (maps.normal_gl == (128, 128, 255)).all()
    assert (maps.roughness == round(0.9 * 255)).all()


def test_a_height_map_may_be_an_exr_image(tmp_path: Path) -> None:
    write_folder(tmp_path, {"ground_col.png": np.full((16, 16, 3), 90, np.uint8)})
    write_channels(tmp_path / "ground_disp.exr", {GREY: np.full((16, 16), 0.375, np.float32)})
    assert (load_texture_folder(tmp_path, 1.0).height == 0.375).all()
    (tmp_path / "ground_disp.exr").write_bytes(b"not an image")
    with pytest.raises(InvalidInputError, match=r"ground_disp\.exr"):
        load_texture_folder(tmp_path, 1.0)


def test_a_folder_without_colour_is_refused(tmp_path: Path) -> None:
    write_folder(tmp_path, {"ground_rough.png": np.zeros((8, 8), np.uint8)})
    with pytest.raises(InvalidInputError, match="diff"):
        load_texture_folder(tmp_path, 1.0)
    with pytest.raises(InvalidInputError, match="nowhere"):
        load_texture_folder(tmp_path / "nowhere", 1.0)


def test_an_unreadable_map_is_refused(tmp_path: Path) -> None:
    (tmp_path / "ground_diff.png").write_bytes(b"not an image")
    with pytest.raises(InvalidInputError, match=r"ground_diff\.png"):
        load_texture_folder(tmp_path, 1.0)
