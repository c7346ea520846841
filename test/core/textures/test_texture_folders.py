"""Folders of PBR maps: names of all kinds, conventions, packed maps, folders of folders."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.textures import load_texture_folder
from oaisys_core.textures.folder import texture_folders

SIZE = 16


def flat(*values: int) -> np.ndarray:
    """An image of one colour, given as RGB or grey."""
    image = np.zeros((SIZE, SIZE, len(values)), np.uint8)
    image[:] = values[::-1]
    return image if len(values) > 1 else image[..., 0]


def write(folder: Path, names: dict[str, np.ndarray]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, image in names.items():
        assert cv2.imwrite(str(folder / name), image)
    return folder


@pytest.mark.parametrize(
    ("color", "normal", "roughness"),
    [
        ("x_COL_4K.png", "x_NRM_4K.png", "x_rough_4K.png"),
        ("x_col.png", "x_nor.png", "x_rgh.png"),
        ("x_diff_1k.png", "x_nor_gl_1k.png", "x_rough_1k.png"),
        ("X-Albedo.png", "X-Normal.png", "X-Roughness.png"),
        ("Ground054_1K-PNG_Color.png", "Ground054_NormalGL.png", "Ground054_Roughness.png"),
        ("rough_color_sand_diff_1k.png", "rough_color_sand_nor_gl.png", "color_x_rough.png"),
    ],
)
def test_maps_are_found_by_the_last_key_word(
    tmp_path: Path, color: str, normal: str, roughness: str
) -> None:
    write(tmp_path, {color: flat(10, 20, 30), normal: flat(128, 90, 250), roughness: flat(51)})
    maps = load_texture_folder(tmp_path, 2.0)
    assert (maps.color_srgb == (10, 20, 30)).all()
    assert (maps.normal_gl == (128, 90, 250)).all()
    assert (maps.roughness == 51).all()


def test_normals_of_directx_point_the_other_way(tmp_path: Path) -> None:
    both = {"a_diff.png": flat(9, 9, 9), "a_nor_dx.png": flat(128, 90, 250)}
    maps = load_texture_folder(write(tmp_path, both), 2.0)
    assert (maps.normal_gl == (128, 255 - 90, 250)).all()
    write(tmp_path, {"a_nor_gl.png": flat(128, 77, 250)})
    assert (load_texture_folder(tmp_path, 2.0).normal_gl == (128, 77, 250)).all()


def test_gloss_is_the_opposite_of_roughness(tmp_path: Path) -> None:
    write(tmp_path, {"a_COL.png": flat(9, 9, 9), "a_GLOSS.png": flat(55)})
    assert (load_texture_folder(tmp_path, 2.0).roughness == 200).all()


def test_packed_maps_hold_occlusion_and_roughness(tmp_path: Path) -> None:
    write(tmp_path, {"a_diff.png": flat(200, 100, 50), "a_arm.png": flat(0, 60, 255)})
    maps = load_texture_folder(tmp_path, 2.0)
    assert (maps.roughness == 60).all()
    assert (maps.color_srgb == (80, 40, 20)).all(), "in full occlusion four tenths remain"
    write(tmp_path, {"a_ao.png": flat(255), "a_rough.png": flat(70)})
    maps = load_texture_folder(tmp_path, 2.0)
    assert (maps.roughness == 70).all()
    assert (maps.color_srgb == (200, 100, 50)).all()


def test_a_folder_of_folders_lists_those_with_colour(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write(tmp_path / name, {f"{name}_diff.png": flat(9, 9, 9)})
    write(tmp_path / "c", {"c_rough.png": flat(9)})
    assert [each.name for each in texture_folders(tmp_path)] == ["a", "b"]
    with pytest.raises(InvalidInputError, match="colour map"):
        texture_folders(tmp_path / "a")
