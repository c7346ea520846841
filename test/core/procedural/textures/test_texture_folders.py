"""Folders of PBR maps: names of all kinds, conventions, packed maps, folders of folders."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.output.exr import write_channels
from oaisys_core.procedural.textures import load_texture_folder
from oaisys_core.procedural.textures.folder import describe_texture_folder, texture_folders
from oaisys_core.procedural.textures.normal_maps import decode_normals
from oaisys_core.scene.terrain_material import PbrMaps

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


def is_normal(maps: PbrMaps, color: tuple[int, int, int]) -> bool:
    """Whether the normals are what a colour in a file stands for, to half a step of 8 bits."""
    usual = np.array(color) / 127.5 - 1
    return bool(np.allclose(decode_normals(maps.normal_gl), usual, atol=0.5 / 127))


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
    assert is_normal(maps, (128, 90, 250))
    assert (maps.roughness == 51).all()


def test_normals_of_directx_point_the_other_way(tmp_path: Path) -> None:
    both = {"a_diff.png": flat(9, 9, 9), "a_nor_dx.png": flat(128, 90, 250)}
    maps = load_texture_folder(write(tmp_path, both), 2.0)
    assert is_normal(maps, (128, 255 - 90, 250))
    write(tmp_path, {"a_nor_gl.png": flat(128, 77, 250)})
    assert is_normal(load_texture_folder(tmp_path, 2.0), (128, 77, 250))


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


@pytest.mark.parametrize(
    "flat_value", [np.uint8(127), np.uint8(128), np.uint16(32767), np.uint16(32768)]
)
@pytest.mark.parametrize("name", ["a_nor_gl.png", "a_nor_dx.png"])
def test_flat_normals_are_exactly_flat(tmp_path: Path, name: str, flat_value: Any) -> None:
    most = np.iinfo(flat_value.dtype).max
    blue_first = np.empty((8, 8, 3), flat_value.dtype)
    blue_first[:] = (most, flat_value, flat_value)
    cv2.imwrite(str(tmp_path / name), blue_first)
    write(tmp_path, {"a_diff.png": flat(9, 9, 9)})
    normals = decode_normals(load_texture_folder(tmp_path, 2.0).normal_gl)
    np.testing.assert_array_equal(normals.reshape(-1, 3), [(0.0, 0.0, 1.0)] * normals[..., 0].size)


LIBRARIES = {
    "Poly Haven": ("x_diff_1k.jpg", "x_nor_dx_1k.png", "x_rough_1k.png"),
    "Poly Haven, older": ("x_diff_1k.jpg", "x_norm_dx_1k.png", "x_rough_1k.png"),
    "ambientCG": ("G_1K-PNG_Color.png", "G_1K-PNG_NormalDX.png", "G_1K-PNG_Roughness.png"),
    "Substance": ("R_BaseColor.png", "R_Normal_DirectX.png", "R_Roughness.png"),
    "Designer": ("r_basecolor.png", "r_normal_directx.png", "r_roughness.png"),
    "Quixel": ("abc_2K_Albedo.png", "abc_2K_Normal-DirectX.png", "abc_2K_Roughness.png"),
    "cgbookcase": ("G01_2K_Base_Color.png", "G01_2K_Normal_DX.png", "G01_2K_Roughness.png"),
    "Poliigon": ("A_COL_VAR1_3K.png", "A_NRM16_DX_3K.png", "A_ROUGHNESS_3K.png"),
    "the convention first": ("a_col.png", "a_dx_normal.png", "a_rough.png"),
}


@pytest.mark.parametrize("names", LIBRARIES.values(), ids=LIBRARIES)
def test_names_of_libraries_are_known_and_green_of_directx_is_turned(
    tmp_path: Path, names: tuple[str, str, str]
) -> None:
    """In DirectX's convention green is what points down (OpenGL's: up)."""
    color, normal, roughness = (flat(90, 90, 90), flat(128, 90, 250), flat(51))
    write(tmp_path, dict(zip(names, (color, normal, roughness), strict=True)))
    maps = load_texture_folder(tmp_path, 2.0)
    assert is_normal(maps, (128, 255 - 90, 250))
    assert np.abs(maps.color_srgb.astype(int) - 90).max() <= 1
    assert (maps.roughness == 51).all()
    opengl = [re.sub("dx|directx", "OpenGL", name, flags=re.IGNORECASE) for name in names]
    write(tmp_path / "gl", dict(zip(opengl, (color, normal, roughness), strict=True)))
    assert is_normal(load_texture_folder(tmp_path / "gl", 2.0), (128, 90, 250))


@pytest.mark.parametrize("folder", ["forest_ground_1k", "downloads"])
def test_strays_are_left_aside_and_told(tmp_path: Path, folder: str) -> None:
    names = {"forest_ground_diffuse_1k.png": flat(9, 9, 9), "forest_ground_rough_1k.png": flat(51)}
    strays = {"old_diff.png": flat(200, 0, 200), "forest_ground_metal_1k.png": flat(9)}
    path = write(tmp_path / folder, names | strays | {"readme_picture.png": flat(1)})
    assert (load_texture_folder(path, 2.0).color_srgb == 9).all()
    assert describe_texture_folder(path) == (
        f"{path}: colour forest_ground_diffuse_1k.png, roughness forest_ground_rough_1k.png;"
        " left aside: forest_ground_metal_1k.png (ground has no such map), old_diff.png"
        " (forest_ground_diffuse_1k.png is used), readme_picture.png (no word of its name is known)"
    )


@pytest.mark.parametrize("name", ["a_ORM.png", "a_OcclusionRoughnessMetallic.png", "a_arm_1k.png"])
def test_packed_maps_have_several_names(tmp_path: Path, name: str) -> None:
    write(tmp_path, {"a_diff.png": flat(200, 100, 50), name: flat(0, 60, 255)})
    maps = load_texture_folder(tmp_path, 2.0)
    assert (maps.roughness == 60).all()
    assert (maps.color_srgb == (80, 40, 20)).all()


def test_roughness_is_green_where_red_means_nothing(tmp_path: Path) -> None:
    """glTF 2.0, 3.9.2: roughness is green, metalness blue."""
    names = {"a_baseColor.png": flat(9, 9, 9), "a_metallicRoughness.png": flat(7, 60, 255)}
    assert (load_texture_folder(write(tmp_path, names), 2.0).roughness == 60).all()


def test_heights_in_metres_are_scaled_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """An EXR of -0.02 to 0.02 m lost all below 0."""
    write(tmp_path, {"a_diff.png": flat(9, 9, 9)})
    rows = np.linspace(-0.02, 0.02, SIZE, dtype=np.float32)
    write_channels(tmp_path / "a_disp.exr", {"Y": np.repeat(rows[:, None], SIZE, axis=1)})
    height = load_texture_folder(tmp_path, 2.0).height
    np.testing.assert_allclose(height[:, 0], np.linspace(0, 1, SIZE), atol=1e-6)
    assert "heights from -0.02 to 0.02" in caplog.text


def test_maps_that_are_no_squares_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write(tmp_path, {"a_diff.png": np.full((SIZE, 2 * SIZE, 3), 9, np.uint8)})
    load_texture_folder(tmp_path, 2.0)
    assert "32 x 16 pixels become a square tile" in caplog.text
