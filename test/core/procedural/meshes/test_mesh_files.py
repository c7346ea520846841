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

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh, merge_parts
from oaisys_core.scene import MeshMaterial
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata


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


@pytest.mark.long
@pytest.mark.blender
def test_a_blend_file_is_read_evaluated_and_its_scripts_never_run(tmp_path: Path) -> None:
    path, trap = tmp_path / "two.blend", tmp_path / "trap"
    in_blender("files.save_blend", str(path), str(trap))

    tall = load_mesh(path, "tall")

    assert len(tall.triangles) == 12, "the modifier doubles it"
    np.testing.assert_allclose(tall.vertices_m.min(axis=0), (10, 0, 0), atol=1e-5)
    np.testing.assert_allclose(tall.vertices_m.max(axis=0), (12, 1, 3), atol=1e-5)
    assert [each.color_srgb for each in tall.materials] == [pytest.approx((1, 0, 0))]
    assert len(load_mesh(path).triangles) == 18
    with pytest.raises(InvalidInputError, match=r"'gone', expected .*small, tall"):
        load_mesh(path, "gone")
    assert not trap.exists()


@pytest.mark.blender
def test_a_damaged_blend_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.blend").write_bytes(b"no blend")
    with pytest.raises(InvalidInputError, match=r"bad\.blend"):
        load_mesh(tmp_path / "bad.blend")


BAD = ["nan", "inf", "-inf", "1e30"]
PLY_HEADER = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
STL = (
    "solid bad\nfacet normal 0 -1 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 {} 1\n"
    "endloop\nendfacet\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n"
    "vertex 0 1 0\nendloop\nendfacet\nendsolid bad\n"
)
TEXT_FILES = {
    ".obj": (4, "# a comment\nv 0 0 0\nv 1 0 0\nv 0 {} 1\nv 0 1 0\nf 1 2 3\nf 1 2 4\n"),
    ".ply": (
        12,
        PLY_HEADER + "0 0 0\n1 0 0\n0 {} 1\n0 1 0\n3 0 1 2\n3 0 1 3\n",
    ),
    ".stl": (6, STL),
}


def bad_file(folder: Path, suffix: str, number: str) -> tuple[Path, int]:
    """A file with one bad coordinate, and the line of it."""
    line, text = TEXT_FILES[suffix]
    path = folder / f"bad{suffix}"
    path.write_text(text.format(number), encoding="ascii")
    return path, line


@pytest.mark.parametrize("suffix", TEXT_FILES)
@pytest.mark.parametrize("number", BAD)
def test_vertices_that_are_not_finite_or_huge_are_refused_with_file_and_line(
    tmp_path: Path, suffix: str, number: str
) -> None:
    path, line = bad_file(tmp_path, suffix, number)
    with pytest.raises(InvalidInputError, match=rf"{path.name}.*finite.*line {line}$"):
        load_mesh(path, field="asset.add.file")


@pytest.mark.parametrize("suffix", [".glb", ".stl", ".ply"])
def test_bad_vertices_of_binary_files_are_refused(tmp_path: Path, suffix: str) -> None:
    box = wedge()
    vertices = np.array(box.vertices)
    vertices[5, 1] = np.nan
    path = tmp_path / f"box{suffix}"
    trimesh.Trimesh(vertices, box.faces, process=False, validate=False).export(path)
    with pytest.raises(InvalidInputError, match="finite coordinates"):
        load_mesh(path)


def test_a_text_stl_with_a_line_that_holds_no_numbers_is_refused(tmp_path: Path) -> None:
    path, _ = bad_file(tmp_path, ".stl", "one")
    with pytest.raises(InvalidInputError, match=path.name):
        load_mesh(path, field="asset.add.file")


TEXTURED = "mtllib bad.mtl\nusemtl wall\nv 0 0 0\nv 1 0 0\nv 0 0 1\nvt 0 0\nvt 1 {}\nvt 0 1\n"


@pytest.mark.parametrize("number", BAD)
def test_texture_coordinates_that_are_not_finite_or_huge_are_refused(
    tmp_path: Path, number: str
) -> None:
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "wall.png")
    (tmp_path / "bad.mtl").write_text("newmtl wall\nmap_Kd wall.png\n", encoding="ascii")
    path = tmp_path / "bad.obj"
    path.write_text(TEXTURED.format("0.5") + "f 1/1 2/2 3/3\n", encoding="ascii")
    assert load_mesh(path).uv is not None
    path.write_text(TEXTURED.format(number) + "f 1/1 2/2 3/3\n", encoding="ascii")
    with pytest.raises(InvalidInputError, match=r"bad\.obj.*finite texture coordinates"):
        load_mesh(path, field="asset.add.file")


def test_a_mesh_without_any_area_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "line.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", encoding="ascii")
    with pytest.raises(InvalidInputError, match="triangle with an area"):
        load_mesh(path)
    path.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 4\n", encoding="ascii")
    assert len(load_mesh(path).triangles) == 2


def refuses(config: dict[str, object], metadata: ModuleMetadata, path: str) -> str:
    """What a step with the metadata is refused for; the world goes on."""
    simulation = Simulation(config_from_mapping(config | {"assets": {"rocks": []}}))
    simulation.step_batch()
    before = simulation.step_sample(modalities=("depth",)).frames[0].data
    step = simulation.step_sample if metadata.asset is not None else simulation.step_batch
    with pytest.raises(InvalidInputError, match=path) as error:
        step(metadata)
    after = simulation.step_sample(modalities=("depth",)).frames[0].data
    np.testing.assert_array_equal(before, after)
    simulation.close()
    return str(error.value)


SMALL: dict[str, object] = {
    "backend": "analytic",
    "stage": {"preset": "plane", "extent_m": 16.0, "resolution_px": 17},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 32}},
    "sensors": {"cameras": [{"width_px": 16, "height_px": 12}]},
}


def test_a_bad_mesh_is_refused_as_an_asset_and_as_a_stage(tmp_path: Path) -> None:
    path, line = bad_file(tmp_path, ".obj", "nan")
    things = {
        "mark": {
            "file": str(path),
            "label": "mark",
            "semantic_id": 77,
            "position_m": [0.0, 0.0, 0.0],
        }
    }
    told = refuses(SMALL, ModuleMetadata(asset={"add": things}), "asset.add.mark.file")
    assert f"line {line}" in told
    stage = ModuleMetadata(custom={"stage": {"mesh": {"file": str(path)}}})
    assert f"line {line}" in refuses(SMALL, stage, "stage.mesh.file")


@pytest.mark.blender
def test_a_bad_mesh_is_refused_with_blender(tmp_path: Path) -> None:
    path, line = bad_file(tmp_path, ".ply", "inf")
    stage = ModuleMetadata(custom={"stage": {"mesh": {"file": str(path)}}})
    told = in_blender("files.refused_stage", SMALL | {"backend": "blender"}, stage)
    assert "stage.mesh.file" in told
    assert f"line {line}" in told


def test_more_materials_than_have_numbers_are_refused() -> None:
    def part(index: int) -> LoadedMesh:
        corners = np.array([[0, 1, 2]], np.int32)
        return LoadedMesh("p", np.eye(3), corners, materials=(MeshMaterial(str(index)),))

    parts = [part(index) for index in range(65_536)]
    most = merge_parts("m", parts, "file")
    assert most.material_of is not None
    assert most.material_of[-1] == 65_535
    with pytest.raises(InvalidInputError, match="at most 65536 materials, not 65537"):
        merge_parts("m", [*parts, part(-1)], "file")
