"""``oaisys evaluate`` as a user runs it, and the files it reads."""

import json
import time
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from commands import oaisys, oaisys_here
from rich.console import Console
from scipy.spatial.transform import Rotation

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import transform
from oaisys_core.system.progress_display import show_stages
from oaisys_core.types import PinholeIntrinsics, TriangleMesh
from oaisys_mapping.certificate.view_files import read_views, write_views
from oaisys_mapping.evaluation.evaluate import Extras, evaluate_reconstruction
from oaisys_mapping.evaluation.truth_io import read_truth, write_truth
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import read_ply, write_ply


def square(z_m: float) -> tuple[np.ndarray, np.ndarray]:
    corners_m = np.array([(-2, -2, z_m), (2, -2, z_m), (2, 2, z_m), (-2, 2, z_m)], float)
    return corners_m, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    mesh, truth = tmp_path / "mesh.ply", tmp_path / "truth.ply"
    write_ply(mesh, ColoredMesh(*square(0.03), np.full((4, 3), 70, np.uint8)))
    write_truth(truth, TriangleMesh(*square(0.0)))
    return mesh, truth


def test_figures_are_printed_as_json(files: tuple[Path, Path], tmp_path: Path) -> None:
    mesh, truth = files
    out = tmp_path / "figures.json"
    result = oaisys_here(
        "evaluate", "--mesh", mesh, "--truth", truth, "--max-rmse", "0.05", "--json", out
    )
    assert result.returncode == 0, result.stderr
    figures = json.loads(result.stdout)
    assert figures == json.loads(out.read_text(encoding="utf-8"))
    assert figures["rmse_m"] == pytest.approx(0.03, abs=1e-5)
    assert figures["closed"] is True
    assert figures["visible_from"] == "everywhere"


def test_progress_is_printed_on_standard_error_only(files: tuple[Path, Path]) -> None:
    mesh, truth = files
    result = oaisys("evaluate", "--mesh", mesh, "--truth", truth)
    assert result.stderr.splitlines()[0] == "measuring: reading the meshes"
    assert json.loads(result.stdout)["closed"] is True


def test_progress_names_each_view_and_each_measurement(files: tuple[Path, Path]) -> None:
    T_map_camera = np.diag([1.0, -1.0, -1.0, 1.0])
    T_map_camera[2, 3] = 5.0
    view = PosedCamera(PinholeIntrinsics(64, 48, 54.0, 54.0, 31.5, 23.5), T_map_camera)
    told: list[str] = []
    evaluate_reconstruction(
        read_ply(files[0]),
        read_truth(files[1]),
        [view, view],
        0.1,
        60.0,
        np.random.default_rng(0),
        Extras(on_progress=told.append),
    )
    assert told == [
        "points on the truth",
        "what view 1 of 2 sees of the truth",
        "what view 2 of 2 sees of the truth",
        "distances from the map to the truth",
        "distances from the truth to the map",
        "offset, holes and classes",
    ]


def test_without_a_terminal_a_line_is_printed_every_few_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = [0.0]
    said: list[str] = []
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    with show_stages("measuring", said.append, Console(file=StringIO())) as on_progress:
        for view in range(40):
            now_s[0] = 0.5 * view
            on_progress(f"view {view}")
    assert said == [f"measuring: view {view}" for view in (0, 10, 20, 30)]


def test_a_missed_threshold_is_exit_1(files: tuple[Path, Path]) -> None:
    mesh, truth = files
    result = oaisys_here("evaluate", "--mesh", mesh, "--truth", truth, "--max-rmse", "0.01")
    assert result.returncode == 1
    assert json.loads(result.stdout)["closed"] is False


@pytest.mark.parametrize(
    ("z_m", "limits", "expected"),
    [
        (0.03, ("--min-iou", "0.5"), "--min-iou: received 0.5, expected no limit on least_iou"),
        (9.0, ("--max-offset", "1"), "--max-offset: received 1.0, expected no limit on offset_m"),
    ],
)
def test_a_limit_of_what_cannot_be_measured_is_exit_2(
    files: tuple[Path, Path], z_m: float, limits: tuple[str, str], expected: str
) -> None:
    """A map without labels met any --min-iou; one 9 m away had no offset."""
    mesh, truth = files
    write_ply(mesh, ColoredMesh(*square(z_m), np.full((4, 3), 70, np.uint8)))
    result = oaisys_here("evaluate", "--mesh", mesh, "--truth", truth, *limits)
    assert result.returncode == 2, result.stdout
    assert expected in result.stderr


def test_a_limit_on_overlap_needs_two_views(files: tuple[Path, Path], tmp_path: Path) -> None:
    mesh, truth = files
    T_map_camera = np.diag([1.0, -1.0, -1.0, 1.0])
    T_map_camera[2, 3] = 5.0
    view = PosedCamera(PinholeIntrinsics(64, 48, 54.0, 54.0, 31.5, 23.5), T_map_camera)
    poses, run = tmp_path / "poses.json", ["evaluate", "--mesh", mesh, "--truth", truth]
    for views, code in (([view], 2), ([view, view], 0)):
        write_views(poses, views)
        result = oaisys_here(*run, "--poses", poses, "--max-overlap-holes", "0")
        assert result.returncode == code, result.stderr
    write_views(poses, [view])
    assert oaisys_here(*run, "--poses", poses).returncode == 0


@pytest.mark.parametrize("name", ["--mesh", "--truth", "--poses"])
def test_a_missing_file_is_exit_2(files: tuple[Path, Path], tmp_path: Path, name: str) -> None:
    arguments = {"--mesh": files[0], "--truth": files[1]}
    arguments[name] = tmp_path / "nowhere"
    result = oaisys_here("evaluate", *(part for pair in arguments.items() for part in pair))
    assert result.returncode == 2
    assert "nowhere" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda data: data[:-9], "truncated"),
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
def test_an_invalid_view_is_refused(
    tmp_path: Path, change: dict[str, object], expected: str
) -> None:
    path = tmp_path / "poses.json"
    write_views(path, [PosedCamera(PinholeIntrinsics(64, 48, 50, 50, 31.5, 23.5), np.eye(4))])
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


def test_views_round_trip_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    camera = PinholeIntrinsics(64, 48, 50.5, 51.25, 30.0, 22.75)
    rotations = Rotation.random(3, rng).as_matrix()
    views = [PosedCamera(camera, transform(R, rng.normal(size=3))) for R in rotations]
    write_views(tmp_path / "poses.json", views)
    back = read_views(tmp_path / "poses.json")
    assert [view.intrinsics for view in back] == [camera] * 3
    assert all(
        np.array_equal(a.T_map_camera, b.T_map_camera) for a, b in zip(views, back, strict=True)
    )


def test_a_mesh_round_trips_through_a_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    vertices_m = rng.normal(size=(30, 3)).astype(np.float32).astype(float)
    triangles = rng.permutation(30).reshape(10, 3).astype(np.int32)
    colors = rng.integers(0, 256, (30, 3)).astype(np.uint8)
    write_ply(tmp_path / "mesh.ply", ColoredMesh(vertices_m, triangles, colors))
    back = read_ply(tmp_path / "mesh.ply")
    assert np.array_equal(back.vertices_m, vertices_m)
    assert np.array_equal(back.triangles, triangles)
    assert np.array_equal(back.colors_rgb, colors)
