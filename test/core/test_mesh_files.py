"""Meshes from files, compared with what was written into them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from blender_process import in_blender
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from oaisys_core.errors import InvalidInputError
from oaisys_core.mesh_files import load_mesh


def wedge() -> trimesh.Trimesh:
    """1 m along x, 2 m along y and 3 m high."""
    return trimesh.creation.box((1.0, 2.0, 3.0))


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
def test_formats_without_an_axis_of_their_own_are_taken_as_they_are(
    tmp_path: Path, suffix: str
) -> None:
    wedge().export(tmp_path / f"box{suffix}")

    mesh = load_mesh(tmp_path / f"box{suffix}")

    assert mesh.name == "box"
    assert len(mesh.triangles) == 12
    np.testing.assert_allclose(np.ptp(mesh.vertices_m, axis=0), (1, 2, 3), atol=1e-6)


def test_gltf_is_turned_from_y_up_to_z_up(tmp_path: Path) -> None:
    box = wedge()
    box.vertices += (0.0, 10.0, 0.0)
    box.export(tmp_path / "box.glb")

    mesh = load_mesh(tmp_path / "box.glb")

    np.testing.assert_allclose(mesh.vertices_m.min(axis=0), (-0.5, -1.5, 9.0), atol=1e-6)
    np.testing.assert_allclose(mesh.vertices_m.max(axis=0), (0.5, 1.5, 11.0), atol=1e-6)


def test_an_object_is_taken_by_its_name_where_the_file_puts_it(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for name, x in (("left", -5.0), ("right", 5.0)):
        T = np.eye(4)
        T[0, 3] = x
        scene.add_geometry(wedge(), node_name=name, geom_name=f"{name}_mesh", transform=T)
    scene.export(tmp_path / "two.glb")

    assert len(load_mesh(tmp_path / "two.glb").triangles) == 24
    right = load_mesh(tmp_path / "two.glb", "right")
    np.testing.assert_allclose(right.vertices_m[:, 0].mean(), 5.0, atol=1e-6)
    with pytest.raises(InvalidInputError, match=r"'middle', expected .*left, right"):
        load_mesh(tmp_path / "two.glb", "middle")


def test_vertex_colours_come_along(tmp_path: Path) -> None:
    box = wedge()
    colors = np.random.default_rng(0).integers(0, 256, (8, 4)).astype(np.uint8)
    box.visual.vertex_colors = colors
    box.export(tmp_path / "box.ply")

    mesh = load_mesh(tmp_path / "box.ply")

    assert mesh.vertex_colors_srgb is not None
    assert (mesh.vertex_colors_srgb == colors[:, :3]).all()


def test_a_texture_comes_with_coordinates_by_corner(tmp_path: Path) -> None:
    square = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], [(0, 1, 2), (0, 2, 3)])
    image = np.zeros((4, 4, 3), np.uint8)
    image[0, 3] = (250, 20, 10)
    material = PBRMaterial(baseColorTexture=Image.fromarray(image))
    uv = square.vertices[:, [0, 2]]
    square.visual = TextureVisuals(uv=uv, material=material)
    square.export(tmp_path / "square.glb")

    mesh = load_mesh(tmp_path / "square.glb")

    assert mesh.color_image_srgb is not None
    assert (mesh.color_image_srgb == image).all()
    assert mesh.uv is not None
    corner = mesh.vertices_m[mesh.triangles]
    # y up became z up: what was z is -y now.
    expected = np.stack((corner[..., 0], -corner[..., 1]), axis=-1)
    np.testing.assert_allclose(mesh.uv, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content"), [("none.obj", None), ("mesh.txt", b"x"), ("bad.glb", b"not one")]
)
def test_what_is_no_mesh_is_refused_by_name(
    tmp_path: Path, name: str, content: bytes | None
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidInputError, match=name):
        load_mesh(tmp_path / name, field="stage.mesh.file")


@pytest.mark.blender
def test_a_blend_file_is_read_evaluated_and_its_scripts_never_run(tmp_path: Path) -> None:
    path, trap = tmp_path / "two.blend", tmp_path / "trap"
    in_blender("blender_jobs_files.save_blend", str(path), str(trap))

    tall = load_mesh(path, "tall")

    assert len(tall.triangles) == 12, "the modifier doubles it"
    np.testing.assert_allclose(tall.vertices_m.min(axis=0), (10, 0, 0), atol=1e-5)
    np.testing.assert_allclose(tall.vertices_m.max(axis=0), (12, 1, 3), atol=1e-5)
    assert tall.vertex_colors_srgb is not None
    assert (tall.vertex_colors_srgb == (255, 0, 0)).all()
    assert len(load_mesh(path).triangles) == 18
    with pytest.raises(InvalidInputError, match=r"'gone', expected .*small, tall"):
        load_mesh(path, "gone")
    assert not trap.exists()


@pytest.mark.blender
def test_a_damaged_blend_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.blend").write_bytes(b"no blend")
    with pytest.raises(InvalidInputError, match=r"bad\.blend"):
        load_mesh(tmp_path / "bad.blend")
