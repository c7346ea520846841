"""Base colours of glTF files, compared with what glTF 2.0, §3.9.2, says about numbers in them."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gltf_files import SQUARE, UV, GltfFile, base_color

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh


def bytes_of(color: tuple[float, float, float]) -> list[int]:
    return [round(value * 255) for value in color]


def test_a_factor_is_linear(tmp_path: Path) -> None:
    file = GltfFile()
    file.square(base_color(baseColorFactor=[0.064, 0.5, 0.2, 1.0]))
    mesh = load_mesh(file.save(tmp_path / "a.gltf"))
    # By IEC 61966-2-1: 1.055 * 0.064 ** (1 / 2.4) - 0.055 is 0.2806.
    assert bytes_of(mesh.materials[0].color_srgb) == [72, 188, 124]


def test_without_a_factor_or_a_material_the_colour_is_white(tmp_path: Path) -> None:
    file = GltfFile()
    file.square(base_color())
    file.square(None, (2, 0, 0))
    mesh = load_mesh(file.save(tmp_path / "a.gltf"))
    assert [bytes_of(each.color_srgb) for each in mesh.materials] == [[255] * 3] * 2


@pytest.mark.parametrize("kind", ["float32", "uint8", "uint16"])
def test_vertex_colours_are_linear_and_count_beside_a_material(tmp_path: Path, kind: str) -> None:
    most = 1 if kind == "float32" else np.iinfo(kind).max
    linear = np.array([(0.064, 0.5, 0.2), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    file = GltfFile()
    colors = file.accessor((linear * most + 1e-9).astype(kind), normalized=kind != "float32")
    file.square(base_color(baseColorFactor=[0.5, 1.0, 1.0, 1.0]), COLOR_0=colors)
    mesh = load_mesh(file.save(tmp_path / "a.gltf"))
    assert mesh.vertex_colors_srgb is not None
    found = mesh.vertex_colors_srgb.astype(int)
    np.testing.assert_allclose(found[0], (72, 188, 124), atol=0 if kind != "uint8" else 2)
    assert found[1:].tolist() == [[255, 0, 0], [0, 255, 0], [0, 0, 255]]
    assert bytes_of(mesh.materials[0].color_srgb) == [188, 255, 255]


def test_an_image_is_multiplied_by_its_factor_in_linear_values(tmp_path: Path) -> None:
    file = GltfFile()
    texture = file.texture(np.full((2, 2, 3), 188, np.uint8))
    file.square(base_color(baseColorTexture=texture, baseColorFactor=[1.0, 0.5, 0.0, 1.0]))
    image = load_mesh(file.save(tmp_path / "a.gltf")).color_image_srgb
    assert image is not None
    # 188 is 0.503 in linear values; its half, 0.2516, is 137.
    assert image[0, 0].tolist() == [188, 137, 0]


def corner_uv(mesh: LoadedMesh) -> dict[tuple[int, int], tuple[float, float]]:
    """Texture coordinates, v up, by the corner of the square in x and z."""
    assert mesh.uv is not None
    corners = np.rint(mesh.vertices_m[mesh.triangles][..., [0, 2]]).astype(int)
    pairs = zip(corners.reshape(-1, 2).tolist(), mesh.uv.reshape(-1, 2).tolist(), strict=True)
    return {tuple(corner): tuple(uv) for corner, uv in pairs}


def test_the_second_coordinates_are_used_where_a_texture_says_so(tmp_path: Path) -> None:
    file = GltfFile()
    texture = file.texture(np.zeros((2, 2, 3), np.uint8)) | {"texCoord": 1}
    file.square(base_color(baseColorTexture=texture), TEXCOORD_1=file.accessor(UV * 0.5))
    uv = corner_uv(load_mesh(file.save(tmp_path / "a.gltf")))
    assert uv[0, 0] == (0.0, 0.5)
    assert uv[1, 1] == (0.5, 1.0)


def test_lacking_coordinates_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = GltfFile()
    texture = file.texture(np.zeros((2, 2, 3), np.uint8)) | {"texCoord": 1}
    file.square(base_color(baseColorTexture=texture))
    with caplog.at_level(logging.WARNING):
        load_mesh(file.save(tmp_path / "a.gltf"))
    assert "thing: lacks TEXCOORD_1, by which its image lies" in caplog.text


def test_a_texture_transform_moves_the_coordinates(tmp_path: Path) -> None:
    file = GltfFile()
    texture = file.texture(np.zeros((2, 2, 3), np.uint8))
    transform = {"offset": [0.25, 0.5], "scale": [2.0, 3.0]}
    texture["extensions"] = {"KHR_texture_transform": transform}
    file.square(base_color(baseColorTexture=texture))
    required = {"extensionsRequired": ["KHR_texture_transform"]}
    uv = corner_uv(load_mesh(file.save(tmp_path / "a.gltf", **required)))
    # v of the file at the square's top is 0, at its bottom 1: 0.5 and 3.5 after the transform.
    assert uv[0, 0] == (0.25, 1 - 3.5)
    assert uv[1, 1] == (2.25, 1 - 0.5)


def test_a_texture_is_rotated_as_blenders_importer_rotates_it(tmp_path: Path) -> None:
    file = GltfFile()
    texture = file.texture(np.zeros((2, 2, 3), np.uint8))
    transform = {"rotation": 0.4, "offset": [0.1, 0.2], "scale": [1.5, 0.7]}
    texture["extensions"] = {"KHR_texture_transform": transform}
    file.square(base_color(baseColorTexture=texture))
    uv = corner_uv(load_mesh(file.save(tmp_path / "a.gltf")))
    # Of the nodes that Blender 4.5 makes of this file.
    assert uv[0, 0] == pytest.approx((0.37259284, 0.1552573))
    assert uv[1, 0] == pytest.approx((1.75418432, 0.73938482))
    assert uv[1, 1] == pytest.approx((1.48159149, 1.3841275))


def test_quantised_and_scaled_meshes_are_where_trimesh_finds_them(tmp_path: Path) -> None:
    file = GltfFile()
    file.square(base_color(baseColorFactor=[1, 0, 0, 1]))
    node = {"mesh": 0, "scale": [2, 3, -4], "translation": [1, 2, 3]}
    node["rotation"] = [0.0, 0.6, 0.0, 0.8]
    path = file.save(tmp_path / "a.gltf", nodes=[node])
    expected = trimesh.load_scene(path).to_geometry()
    mesh = load_mesh(path)
    turned = np.array(expected.vertices)[:, [0, 2, 1]] * (1, -1, 1)
    np.testing.assert_allclose(np.sort(mesh.vertices_m, axis=0), np.sort(turned, axis=0), atol=1e-5)

    quantised = GltfFile()
    quantised.square(base_color())
    values = quantised.accessor((SQUARE * 255).astype(np.uint8), normalized=True)
    quantised.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = values
    path = quantised.save(tmp_path / "q.gltf", extensionsRequired=["KHR_mesh_quantization"])
    np.testing.assert_allclose(np.ptp(load_mesh(path).vertices_m, axis=0), (1, 0, 1), atol=1e-6)


@pytest.mark.parametrize(
    ("extension", "converter"),
    [
        ("KHR_draco_mesh_compression", "Blender"),
        ("EXT_meshopt_compression", "gltf-transform"),
        ("KHR_texture_basisu", "ktxdecompress"),
        ("VENDOR_new_geometry", "without this extension"),
    ],
)
def test_what_is_not_read_is_named_with_what_converts_it(
    tmp_path: Path, extension: str, converter: str
) -> None:
    file = GltfFile()
    file.square(base_color())
    path = file.save(tmp_path / "a.gltf", extensionsRequired=[extension])
    with pytest.raises(InvalidInputError, match=f"no {extension}: .*{converter}"):
        load_mesh(path)


def test_a_texture_that_only_ktx2_has_is_named(tmp_path: Path) -> None:
    file = GltfFile()
    texture = file.texture(np.zeros((2, 2, 3), np.uint8))
    file.square(base_color(baseColorTexture=texture))
    file.document["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    with pytest.raises(InvalidInputError, match=r"no KHR_texture_basisu: .*ktxdecompress"):
        load_mesh(file.save(tmp_path / "a.gltf"))


def test_a_missing_picture_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = GltfFile()
    file.square(base_color(baseColorTexture=file.texture(np.zeros((2, 2, 3), np.uint8))))
    path = file.save(tmp_path / "a.gltf", images=[{"uri": "skin.png"}])
    with caplog.at_level(logging.WARNING):
        assert load_mesh(path).color_image_srgb is None
    assert "skin.png" in caplog.text
    assert "missing" in caplog.text


def test_glass_keeps_its_surface_and_a_mask_its_holes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    glass = base_color(baseColorFactor=[1, 1, 1, 0.3]) | {"alphaMode": "BLEND", "name": "glass"}
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[0, 0, 3] = 100
    file = GltfFile()
    file.square(glass)
    texture = file.texture(pixels)
    for factor, mode in ((1.0, "MASK"), (0.5, "BLEND"), (1.0, "OPAQUE")):
        color = base_color(baseColorTexture=texture, baseColorFactor=[1, 1, 1, factor])
        file.square(color | {"alphaMode": mode, "alphaCutoff": 0.5})
    with caplog.at_level(logging.WARNING):
        materials = load_mesh(file.save(tmp_path / "a.gltf")).materials
    assert materials[0].opacity is None
    assert "'glass': is see-through" in caplog.text
    assert materials[1].opacity is not None
    assert (materials[1].opacity >= materials[1].cutoff).tolist() == [[False, True], [True, True]]
    assert materials[2].cutoff == pytest.approx(255.0)
    assert materials[3].opacity is None


def test_a_blend_of_alpha_0_is_opaque_and_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = GltfFile()
    clear = base_color(baseColorFactor=[1, 1, 1, 0.0]) | {"alphaMode": "BLEND", "name": "clear"}
    file.square(clear)
    image = base_color(baseColorTexture=file.texture(np.zeros((2, 2, 4), np.uint8)))
    file.square(image | {"alphaMode": "BLEND", "name": "image"})
    with caplog.at_level(logging.WARNING):
        materials = load_mesh(file.save(tmp_path / "a.gltf")).materials
    assert [each.opacity for each in materials] == [None, None]
    assert "'clear': is see-through" in caplog.text
    assert "'image': is see-through" in caplog.text
