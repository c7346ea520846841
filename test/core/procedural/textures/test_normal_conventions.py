"""Normals without a convention follow the heights beside them; what is no map is left aside."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.textures import load_texture_folder
from oaisys_core.procedural.textures.map_names import maps_in
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
    """Heights, 0 to 1, and normals by their closed form: x right, y up in the image."""
    rows, cols = np.mgrid[:SIZE, :SIZE] * 2 * np.pi / SIZE
    height = 0.5 + 0.25 * (np.sin(cols) + np.sin(2 * rows))
    normals = np.stack((-np.cos(cols), 2 * np.cos(2 * rows), np.full_like(rows, 4.0)), axis=-1)
    return height, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def encoded(normals: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint((normals[..., ::-1] + 1) * 127.5).astype(np.uint8)


@pytest.mark.parametrize("green", [1, -1])
@pytest.mark.parametrize("name", ["a_normal.png", "a_Normal_4K.png"])
def test_normals_without_a_convention_follow_the_height_map(
    folder: Path, green: int, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    height, normals = bumps()
    save(folder / "a_disp.png", np.rint(height * 65535).astype(np.uint16))
    save(folder / name, encoded(normals * (1, green, 1)))
    found = decode_normals(load_texture_folder(folder, 1.0).normal_gl)
    np.testing.assert_allclose(found, normals, atol=0.012)
    assert ("OpenGL" if green == 1 else "DirectX") in caplog.text


def test_a_name_that_contradicts_the_height_map_is_told(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    height, normals = bumps()
    save(folder / "a_disp.png", np.rint(height * 65535).astype(np.uint16))
    save(folder / "a_nor_gl.png", encoded(normals * (1, -1, 1)))
    load_texture_folder(folder, 1.0)
    assert "a_nor_gl.png: its name says gl, the heights do not" in caplog.text


def test_a_grey_normal_map_is_refused(folder: Path) -> None:
    save(folder / "a_normal.png", GREY)
    with pytest.raises(InvalidInputError, match="grey"):
        load_texture_folder(folder, 1.0)


@pytest.mark.parametrize(
    "name",
    [
        "a_bent_normal.png",
        "._a_diff.png",
        "a_rough.tga",
    ],
)
def test_what_only_looks_like_a_map_is_left_aside(folder: Path, name: str) -> None:
    (folder / name).write_bytes(b"not an image")
    found = maps_in(folder)
    assert {each.path.name for each in found.used.values()} == {"a_diff.png"}
    assert name.startswith(".") or name in {path.name for path in found.aside}
    assert (load_texture_folder(folder, 1.0).color_srgb == 90).all()
