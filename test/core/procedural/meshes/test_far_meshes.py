"""Meshes in coordinates of a map of the Earth, compared with trimesh in float64."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from oaisys_core.config import config_from_mapping
from oaisys_core.procedural.meshes.checks import local_origin
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.terrain.mesh_ground import MeshGround, mesh_ground
from oaisys_core.world.module import World
from oaisys_core.world.modules.assets.prototypes import PrototypeLibrary
from oaisys_core.world.modules.stage import StageModule

UTM = np.array([500_000.0, 5_200_000.0, 400.0])
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


def test_a_position_that_brings_it_back_is_exact(tmp_path: Path) -> None:
    file = exported(hilly(UTM), tmp_path)
    x, y, z = (-UTM).tolist()
    ground = mesh_ground(load_mesh(file), 1.0, "z", (x, y, z))
    assert ground.local_origin_m == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(ground.points_m, hilly(np.zeros(3)).vertices, rtol=0, atol=1e-6)


def test_a_stage_near_the_origin_keeps_its_bytes(tmp_path: Path) -> None:
    file = exported(hilly(np.array([3000.0, -8.0, 0.0])), tmp_path)
    mesh = load_mesh(file)
    assert mesh.vertices_m.dtype == np.float32
    ground = mesh_ground(mesh, 1.0, "z", (0.0, 0.0, 0.0))
    assert ground.local_origin_m == (0.0, 0.0, 0.0)
    assert (ground.points_m == mesh.vertices_m).all()


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
