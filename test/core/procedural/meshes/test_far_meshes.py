"""Meshes in coordinates of a map of the Earth, compared with trimesh in float64."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.stage import StageMeshConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.checks import local_origin
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.procedural.terrain.mesh_ground import MeshGround, mesh_ground
from oaisys_core.world.config_files import name_faults
from oaisys_core.world.module import World
from oaisys_core.world.modules.assets import prototypes
from oaisys_core.world.modules.assets.prototypes import PrototypeLibrary
from oaisys_core.world.modules.stage import StageModule, load_stage_mesh

UTM = np.array([500_000.0, 5_200_000.0, 400.0])
HILL = {"name": "hill", "position_m": [0, 0, 0], "label": "hill", "semantic_id": 40}
FARAWAY = {"UTM": UTM, "100 km": np.array([1e5, -1e5, 0.0]), "one axis": np.array([0.0, 3e6, 0.0])}


def hilly(offset: np.ndarray) -> trimesh.Trimesh:
    """A grid of 81 x 81 points, 20 cm apart, with hills, in float64."""
    x, y = np.meshgrid(np.arange(81) * 0.2, np.arange(81) * 0.2)
    z = 0.3 * np.sin(x) * np.cos(y / 2) + 2.0
    vertices = np.column_stack((x.ravel(), y.ravel(), z.ravel())) + offset
    n = np.arange(80 * 81).reshape(80, 81)[:, :-1].ravel()
    corners = np.concatenate((np.c_[n, n + 1, n + 82], np.c_[n, n + 82, n + 81]))
    return trimesh.Trimesh(vertices, corners, process=False)


def exported(mesh: trimesh.Trimesh, folder: Path) -> Path:
    """An OBJ file whose numbers have ten digits after the point."""
    file = folder / "hills.obj"
    lines = [f"v {x:.10f} {y:.10f} {z:.10f}" for x, y, z in mesh.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces]
    file.write_text("\n".join(lines) + "\n")
    return file


@pytest.mark.parametrize("where", FARAWAY)
def test_a_stage_far_from_the_origin_keeps_rows_and_heights(
    tmp_path: Path, where: str, caplog: pytest.LogCaptureFixture
) -> None:
    offset = FARAWAY[where]
    truth = hilly(offset)
    file = exported(truth, tmp_path)
    world = World()
    config = config_from_mapping({"stage": {"mesh": {"file": str(file)}}})
    with caplog.at_level(logging.WARNING):
        StageModule(config.stage).step_batch(world, None, np.random.default_rng(0))
    ground = world.ground
    assert isinstance(ground, MeshGround)
    assert world.stage_notes["local_origin_m"] == list(ground.local_origin_m)
    origin = np.asarray(ground.local_origin_m)
    told = re.search(r"the map's origin is at \[([^]]+)\]", caplog.text)
    assert told is not None
    assert [int(metres) for metres in told[1].split(", ")] == list(ground.local_origin_m)
    assert (origin == np.round(origin)).all()
    assert (np.abs(origin - offset)[np.abs(offset) > 8192] < 9).all()
    assert len(np.unique(ground.points_m[:, 1])) == 81
    np.testing.assert_allclose(ground.points_m + origin, truth.vertices, rtol=0, atol=2e-5)
    rng = np.random.default_rng(1)
    corners = truth.triangles[rng.integers(len(truth.faces), size=200)]
    points = np.einsum("nk,nkd->nd", rng.dirichlet((1, 1, 1), 200), corners)
    found_m = ground.height_at(points[:, :2] - origin[:2]) + origin[2]
    np.testing.assert_allclose(found_m, points[:, 2], rtol=0, atol=5e-5)


@pytest.mark.parametrize("kind", ["ply", "stl"])
def test_digits_of_text_files_are_read_as_float64(tmp_path: Path, kind: str) -> None:
    truth = hilly(UTM)
    file = tmp_path / f"hills.{kind}"
    if kind == "ply":
        header = "ply\nformat ascii 1.0\nelement vertex 6561\nproperty float x\n"
        header += "property  float32 y\nproperty float z\nelement face 12800\n"
        header += "property list uchar int vertex_indices\nend_header\n"
        rows = [f"{x:.10f} {y:.10f} {z:.10f}" for x, y, z in truth.vertices]
        rows += [f"3 {a} {b} {c}" for a, b, c in truth.faces]
        file.write_text(header + "\n".join(rows) + "\n")
    else:
        facet = "facet normal 0 0 1\nouter loop\n{}\nendloop\nendfacet"
        corners = [[f"vertex {x:.10f} {y:.10f} {z:.10f}" for x, y, z in t] for t in truth.triangles]
        facets = [facet.format("\n".join(each)) for each in corners]
        file.write_text("\n".join(["solid a", *facets, "endsolid a", ""]))
    found = load_stage_mesh(StageMeshConfig(file=file))
    expected = truth.vertices if kind == "ply" else truth.triangles.reshape(-1, 3)
    np.testing.assert_allclose(found.vertices_m, expected, rtol=0, atol=2e-9)


def export_float64(mesh: trimesh.Trimesh, file: Path) -> Path:
    """Write a binary .ply file of ``double``."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(mesh.vertices)}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices"]
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    head = "\n".join([*lines, "end_header", ""]).encode()
    file.write_bytes(head + mesh.vertices.astype("<f8").tobytes() + faces.tobytes())
    return file


def export_float32(mesh: trimesh.Trimesh, file: Path) -> None:
    """Write a binary .ply, .stl or .glb file, in which trimesh stores float32."""
    file.write_bytes(mesh.export(file_type=file.suffix[1:]))


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".glb"])
def test_a_stage_whose_file_has_lost_its_digits_is_refused(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"hills{suffix}"
    export_float32(hilly(UTM), file)
    with pytest.raises(InvalidInputError) as error:
        load_stage_mesh(StageMeshConfig(file=file))
    said = str(error.value)
    assert said.startswith("stage.mesh.file: received ")
    assert "resolve 0.001 of its units, but as float32 they have a step of 0.5 at 5200016" in said
    assert "float64" in said
    assert "local origin" in said
    config = config_from_mapping({"stage": {"mesh": {"file": str(file)}}})
    (fault,) = name_faults(config)
    assert "have a step of 0.5" in fault


@pytest.mark.blender
def test_what_blender_reads_is_float32(tmp_path: Path) -> None:
    corners = UTM + np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    points = ", ".join(f"({x}, {y}, {z})" for x, y, z in corners.tolist())
    file = tmp_path / "a.usda"
    file.write_text(
        '#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n)\ndef Mesh "own"\n{\n'
        "    int[] faceVertexCounts = [3]\n"
        f"    int[] faceVertexIndices = [0, 1, 2]\n    point3f[] points = [{points}]\n}}\n"
    )
    with pytest.raises(InvalidInputError, match=r"have a step of 0\.5 at 5200001"):
        load_stage_mesh(StageMeshConfig(file=file))


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".glb"])
def test_float32_is_fine_where_it_resolves_a_millimetre(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"hills{suffix}"
    export_float32(hilly(np.array([16_300.0, 0.0, 0.0])), file)
    load_stage_mesh(StageMeshConfig(file=file))
    export_float32(hilly(np.array([16_400.0, 0.0, 0.0])), file)
    load_stage_mesh(StageMeshConfig(file=file, scale=0.1))
    with pytest.raises(InvalidInputError, match=r"have a step of 0\.00195 at 16416"):
        load_stage_mesh(StageMeshConfig(file=file))


def test_a_node_of_gltf_brings_a_mesh_far_away_exactly(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    to_utm = trimesh.transformations.translation_matrix(UTM)
    scene.add_geometry(hilly(np.zeros(3)), transform=to_utm)
    file = tmp_path / "hills.glb"
    file.write_bytes(scene.export(file_type="glb"))
    found = load_stage_mesh(StageMeshConfig(file=file, up="z"))
    low = hilly(np.zeros(3)).vertices.min(axis=0)
    assert found.float32.step < 1e-5
    np.testing.assert_allclose(found.vertices_m.min(axis=0)[0], (low + UTM)[0], rtol=0, atol=1e-6)


def test_an_object_whose_file_has_lost_its_digits_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "hill.stl"
    export_float32(hilly(UTM), file)
    library = PrototypeLibrary("rock", 1.0, 64, 0)
    config = config_from_mapping({"assets": {"objects": [{"file": str(file)} | HILL]}})
    with pytest.raises(InvalidInputError, match=r"have a step of 0\.5 at 5200016"):
        library.prototype(config.assets.objects[0], np.random.default_rng(0))


def test_a_position_that_brings_it_back_is_exact(tmp_path: Path) -> None:
    file = exported(hilly(UTM), tmp_path)
    x, y, z = (-UTM).tolist()
    ground = mesh_ground(load_mesh(file), 1.0, "z", (x, y, z))
    assert ground.local_origin_m == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(ground.points_m, hilly(np.zeros(3)).vertices, rtol=0, atol=1e-6)


def test_a_stage_near_the_origin_keeps_its_bytes(tmp_path: Path) -> None:
    file = exported(hilly(np.array([3000.0, -8.0, 0.0])), tmp_path)
    mesh = load_mesh(file)
    ground = mesh_ground(mesh, 1.0, "z", (0.0, 0.0, 0.0))
    assert ground.local_origin_m == (0.0, 0.0, 0.0)
    assert (ground.points_m == mesh.vertices_m.astype(np.float32)).all()


@pytest.mark.parametrize("scale", [1000.0, 2000.0, 1e5, 0.6])
@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_a_stage_in_kilometres_keeps_rows_and_heights(
    tmp_path: Path, kind: str, scale: float
) -> None:
    """Its coordinates are small numbers, whose float32 are as coarse as those of metres."""
    truth = hilly(UTM)
    small = trimesh.Trimesh(truth.vertices / scale, truth.faces, process=False)
    file = export_float64(small, tmp_path / "hills.ply")
    if kind == "obj":
        file = exported(small, tmp_path)
    ground = mesh_ground(load_mesh(file), scale, "z", (0.0, 0.0, 0.0))
    assert len(np.unique(ground.points_m[:, 1])) == 81
    found_m = ground.points_m + np.asarray(ground.local_origin_m)
    # The ten digits after the point of the text are hundredths of a millimetre at 1e5.
    np.testing.assert_allclose(found_m, truth.vertices, rtol=0, atol=2e-5 + scale * 1e-10)


def test_an_object_far_from_its_origin_keeps_its_form(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = exported(hilly(UTM), tmp_path)
    library = PrototypeLibrary("rock", 1.0, 64, 0)
    config = config_from_mapping(
        {
            "assets": {
                "objects": [
                    {"name": "hill", "file": str(file), "anchor": "origin", "position_m": [0, 0, 0]}
                    | {"label": "hill", "semantic_id": 40}
                ]
            }
        }
    )
    with caplog.at_level(logging.WARNING):
        found = library.prototype(config.assets.objects[0], np.random.default_rng(0))
    assert "that of the object is at [500008, 5200008, 0]" in caplog.text
    expected = hilly(UTM).vertices - local_origin(hilly(UTM).vertices)
    np.testing.assert_allclose(found.vertices_m, expected, rtol=0, atol=2e-5)


def test_an_object_in_millimetres_stays_where_its_file_has_it(tmp_path: Path) -> None:
    mesh = hilly(np.zeros(3))
    mesh.vertices = mesh.vertices * 1000 + (9000.0, 0.0, 0.0)
    file = exported(mesh, tmp_path)
    config = config_from_mapping(
        {
            "assets": {
                "objects": [
                    {"name": "hill", "file": str(file), "anchor": "origin", "position_m": [0, 0, 0]}
                    | {"label": "hill", "semantic_id": 40}
                ]
            }
        }
    )
    library = PrototypeLibrary("rock", 1.0, 64, 0)
    found = library.prototype(config.assets.objects[0], np.random.default_rng(0))
    assert (found.vertices_m == mesh.vertices.astype(np.float32)).all()


@pytest.mark.parametrize(("anchor", "origin"), [("origin", (500, 5200, 0)), ("base", None)])
def test_an_object_in_kilometres_keeps_its_form(
    tmp_path: Path, anchor: str, origin: tuple[float, ...] | None, caplog: pytest.LogCaptureFixture
) -> None:
    truth = hilly(UTM).vertices / 1000
    file = export_float64(
        trimesh.Trimesh(truth, hilly(UTM).faces, process=False), tmp_path / "a.ply"
    )
    entry = HILL | {"file": str(file), "anchor": anchor, "scale": 1000.0}
    config = config_from_mapping({"assets": {"objects": [entry]}})
    library = PrototypeLibrary("rock", 1.0, 64, 0)
    with caplog.at_level(logging.WARNING):
        found = library.prototype(config.assets.objects[0], np.random.default_rng(0))
    assert ("the object is at [500, 5200, 0]" in caplog.text) == (origin is not None)
    low, high = truth.min(axis=0), truth.max(axis=0)
    place = (*((low + high) / 2)[:2], low[2]) if origin is None else origin
    np.testing.assert_allclose(1000 * found.vertices_m, 1000 * (truth - place), rtol=0, atol=1e-4)


def test_an_object_near_its_origin_stays_where_its_file_has_it(tmp_path: Path) -> None:
    small = hilly(UTM * 0 + (3000.0, 0.0, 0.0)).vertices / 1000
    file = export_float64(
        trimesh.Trimesh(small, hilly(UTM).faces, process=False), tmp_path / "a.ply"
    )
    entry = HILL | {"file": str(file), "anchor": "origin", "scale": 1000.0}
    config = config_from_mapping({"assets": {"objects": [entry]}})
    library = PrototypeLibrary("rock", 1.0, 64, 0)
    found = library.prototype(config.assets.objects[0], np.random.default_rng(0))
    assert (found.vertices_m == small.astype(np.float32)).all()


def test_objects_of_several_scales_share_the_mesh_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each scale read the file again, and each drawn one stayed in memory."""
    file = exported(hilly(np.zeros(3)), tmp_path)
    read: list[Path] = []

    def counted(path: Path, object_name: str | None, field: str) -> LoadedMesh:
        read.append(path)
        return load_mesh(path, object_name, field)

    monkeypatch.setattr(prototypes, "load_mesh", counted)
    thing = HILL | {"file": str(file), "anchor": "origin"}
    things = [thing | {"name": f"hill_{scale:g}", "scale": scale} for scale in (1.0, 2.0)]
    objects = config_from_mapping({"assets": {"objects": things}}).assets.objects
    library = PrototypeLibrary("rock", 1.0, 64, 0)
    one, other = (library.prototype(each, np.random.default_rng(0)) for each in objects)
    assert one is other
    assert len(read) == 1


@pytest.mark.parametrize("stray", [(9.4e6, 5_200_008.0, 400.0), (0.0, 0.0, 0.0)])
def test_a_vertex_that_no_triangle_has_moves_no_origin(
    tmp_path: Path, stray: tuple[float, float, float]
) -> None:
    truth = hilly(UTM)
    more = np.vstack((stray, truth.vertices))
    strayed = trimesh.Trimesh(more, truth.faces + 1, process=False)
    found = load_mesh(export_float64(strayed, tmp_path / "a.ply"))
    ground = mesh_ground(found, 1.0, "z", (0.0, 0.0, 0.0))
    assert ground.local_origin_m == (500_008.0, 5_200_008.0, 0.0)
    assert (ground.corners == truth.faces).all()
    found_m = ground.points_m + np.asarray(ground.local_origin_m)
    np.testing.assert_allclose(found_m, truth.vertices, rtol=0, atol=2e-5)


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_a_vertex_that_no_triangle_has_hides_no_lost_digits(tmp_path: Path, suffix: str) -> None:
    """Beside the origin, the mesh seemed to lie around it."""
    truth = hilly(UTM)
    more = np.vstack((truth.vertices, -UTM))
    file = tmp_path / f"a{suffix}"
    export_float32(trimesh.Trimesh(more, truth.faces, process=False), file)
    with pytest.raises(InvalidInputError, match=r"have a step of 0\.5 at 5200016"):
        load_stage_mesh(StageMeshConfig(file=file))


def test_a_vertex_that_no_triangle_has_keeps_the_colours_of_others(tmp_path: Path) -> None:
    mesh = hilly(np.zeros(3))
    colors = np.arange(4 * (len(mesh.vertices) + 1), dtype=np.uint32).reshape(-1, 4) % 251
    more = np.vstack(((50.0, 0.0, 0.0), mesh.vertices))
    strayed = trimesh.Trimesh(more, mesh.faces + 1, vertex_colors=colors, process=False)
    file = tmp_path / "a.ply"
    export_float32(strayed, file)
    found = load_mesh(file)
    assert found.vertex_colors_srgb is not None
    assert (found.vertex_colors_srgb == colors[1:, :3]).all()


@pytest.mark.blender
def test_a_vertex_that_no_triangle_has_is_left_out_of_what_blender_reads(tmp_path: Path) -> None:
    file = tmp_path / "a.usda"
    file.write_text(
        '#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n)\ndef Mesh "own"\n{\n'
        "    int[] faceVertexCounts = [3]\n    int[] faceVertexIndices = [1, 2, 3]\n"
        "    point3f[] points = [(900, 0, 0), (0, 0, 0), (1, 0, 0), (0, 1, 0)]\n}\n"
    )
    assert load_mesh(file).vertices_m.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
