"""``oaisys evaluate`` as a user runs it, and the files it reads."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import transform
from oaisys_core.types import PinholeIntrinsics, TriangleMesh
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import read_ply, write_ply, write_truth
from oaisys_mapping.view_files import read_views, write_views
from oaisys_mapping.visibility import View


def square(z_m: float) -> tuple[np.ndarray, np.ndarray]:
    corners_m = np.array([(-2, -2, z_m), (2, -2, z_m), (2, 2, z_m), (-2, 2, z_m)], float)
    return corners_m, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    mesh, truth = tmp_path / "mesh.ply", tmp_path / "truth.ply"
    write_ply(mesh, ColoredMesh(*square(0.03), np.full((4, 3), 70, np.uint8)))
    write_truth(truth, TriangleMesh(*square(0.0)))
    return mesh, truth


def evaluate(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "oaisys_core", "evaluate", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_figures_are_printed_as_json(files: tuple[Path, Path], tmp_path: Path) -> None:
    mesh, truth = files
    out = tmp_path / "figures.json"
    result = evaluate("--mesh", mesh, "--truth", truth, "--max-rmse", "0.05", "--json", out)
    assert result.returncode == 0, result.stderr
    figures = json.loads(result.stdout)
    assert figures == json.loads(out.read_text(encoding="utf-8"))
    assert figures["rmse_m"] == pytest.approx(0.03, abs=1e-5)
    assert figures["closed"] is True
    assert figures["visible_from"] == "everywhere"


def test_a_missed_threshold_is_exit_1(files: tuple[Path, Path]) -> None:
    mesh, truth = files
    result = evaluate("--mesh", mesh, "--truth", truth, "--max-rmse", "0.01")
    assert result.returncode == 1
    assert json.loads(result.stdout)["closed"] is False


@pytest.mark.parametrize("name", ["--mesh", "--truth", "--poses"])
def test_a_missing_file_is_exit_2(files: tuple[Path, Path], tmp_path: Path, name: str) -> None:
    arguments = {"--mesh": files[0], "--truth": files[1]}
    arguments[name] = tmp_path / "nowhere"
    result = evaluate(*(part for pair in arguments.items() for part in pair))
    assert result.returncode == 2
    assert "nowhere" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda data: data[:-9], "ends too early"),
        (lambda data: b"junk" * 50, "with triangles"),
        (lambda data: data.replace(np.float32(-2).tobytes(), b"\0\0\xc0\x7f"), "finite"),
        (lambda data: data[:-4] + np.int32(9).tobytes(), "vertices that are in the file"),
    ],
)
def test_a_damaged_mesh_is_refused(
    files: tuple[Path, Path], damage: Callable[[bytes], bytes], expected: str
) -> None:
    mesh, _ = files
    mesh.write_bytes(damage(mesh.read_bytes()))
    with pytest.raises(InvalidInputError, match=expected):
        read_ply(mesh)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"K": [[50, 0], [0, 50]]}, r"K \(3, 3\)"),
        ({"K": [[0, 0, 9], [0, 50, 9], [0, 0, 1]]}, "focal lengths"),
        ({"width_px": 0}, "a size"),
        ({"T_map_camera": (2 * np.eye(4)).tolist()}, "rigid"),
        ({"T_map_camera": np.full((4, 4), np.nan).tolist()}, "finite"),
    ],
)
def test_a_view_that_is_none_is_refused(
    tmp_path: Path, change: dict[str, object], expected: str
) -> None:
    path = tmp_path / "poses.json"
    write_views(path, [View(PinholeIntrinsics(64, 48, 50, 50, 31.5, 23.5), np.eye(4))])
    data = json.loads(path.read_text(encoding="utf-8"))
    data["views"][0].update(change)
    path.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(InvalidInputError, match=expected) as caught:
        read_views(path)
    assert "views.0" in caught.value.field


@pytest.mark.parametrize("text", ["[", "[]", "{}", '{"views": 3}'])
def test_a_file_without_views_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "poses.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInputError, match="views"):
        read_views(path)


def test_views_come_back_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    camera = PinholeIntrinsics(64, 48, 50.5, 51.25, 30.0, 22.75)
    rotations = Rotation.random(3, rng).as_matrix()
    views = [View(camera, transform(R, rng.normal(size=3))) for R in rotations]
    write_views(tmp_path / "poses.json", views)
    back = read_views(tmp_path / "poses.json")
    assert [view.intrinsics for view in back] == [camera] * 3
    assert all(
        np.array_equal(a.T_map_camera, b.T_map_camera) for a, b in zip(views, back, strict=True)
    )


def test_a_mesh_comes_back_from_its_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    vertices_m = rng.normal(size=(30, 3)).astype(np.float32).astype(float)
    triangles = rng.permutation(30).reshape(10, 3).astype(np.int32)
    colors = rng.integers(0, 256, (30, 3)).astype(np.uint8)
    write_ply(tmp_path / "mesh.ply", ColoredMesh(vertices_m, triangles, colors))
    back = read_ply(tmp_path / "mesh.ply")
    assert np.array_equal(back.vertices_m, vertices_m)
    assert np.array_equal(back.triangles, triangles)
    assert np.array_equal(back.colors_rgb, colors)
