"""The report holds what a reader needs, in one file that needs no network."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from oaisys_core.types import TriangleMesh
from oaisys_mapping import pictures
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.metrics import evaluate_reconstruction
from oaisys_mapping.report import SurveyReport, ViewRecord, write_report
from oaisys_mapping.thresholds import Thresholds


def square(z_m: float) -> tuple[np.ndarray, np.ndarray]:
    corners_m = np.array([(-2, -2, z_m), (2, -2, z_m), (2, 2, z_m), (-2, 2, z_m)], float)
    return corners_m, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def make_report(max_rmse_m: float) -> SurveyReport:
    mesh = ColoredMesh(*square(0.02), np.full((4, 3), 120, np.uint8))
    rng = np.random.default_rng(0)
    evaluation = evaluate_reconstruction(mesh, TriangleMesh(*square(0.0)), None, 0.1, 60.0, rng)
    depth_m = np.full((12, 16), 3.0, np.float32)
    depth_m[0] = np.inf
    ids = np.arange(192).reshape(12, 16) % 3
    view = ViewRecord(
        np.full((12, 16, 3), 99, np.uint8),
        depth_m,
        ids.astype(np.uint16),
        ids.astype(np.uint32),
        {"render": 0.5, "transfer and publish": 0.1},
    )
    facts = {
        "views": 4,
        "seed": 1,
        "backend": "analytic",
        "backend_version": "0",
        "quality": "standard",
        "seconds_total": 9.0,
        "seconds_per_view": 0.6,
    }
    return SurveyReport(
        "Survey of a square",
        facts,
        evaluation,
        Thresholds(max_rmse_m=max_rmse_m),
        mesh,
        [view] * 4,
        2,
        {1: "gravel", 2: "sand & <dust>"},
        "oaisys survey --seed 1",
        "seed: 1",
    )


def test_the_page_is_whole_and_asks_for_nothing_else(tmp_path: Path) -> None:
    write_report(make_report(0.05), tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    parts = (
        "The loop closes",
        "20.0 mm",
        "✓ rmse_m",
        "at most 0.05",
        "oaisys survey --seed 1",
        "seed: 1",
        "sand &amp; &lt;dust&gt;",
        "<span>3.0</span>",
    )
    for part in parts:
        assert part in page
    sources = re.findall(r'(?:src|href)="([^"]{0,22})', page)
    assert len(sources) == 11
    assert all(source.startswith("data:image/") for source in sources)
    assert "http" not in page


def test_a_missed_threshold_is_told_in_both_reports(tmp_path: Path) -> None:
    write_report(make_report(0.01), tmp_path)
    figures = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert figures["closed"] is False
    assert "rmse_m" in figures["missed"][0]
    assert figures["thresholds"]["max_rmse_m"] == 0.01
    assert figures["versions"]["numpy"] == np.__version__
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "does not close" in page
    assert figures["missed"][0] in page
    assert "✗ rmse_m" in page


def test_report_json_has_what_other_programs_read(tmp_path: Path) -> None:
    report = make_report(0.05)
    write_report(report, tmp_path)
    figures = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert report.facts.items() <= figures.items()
    promised = {"voxel_size_m", "rmse_m", "accuracy_mean_m", "completion_ratio", "f_score"}
    assert promised | {"hole_ratio", "closed"} <= figures.keys()
    assert figures["rmse_m"] == pytest.approx(0.02, abs=1e-5)


def test_a_mesh_fills_its_pictures() -> None:
    mesh = ColoredMesh(*square(0.0), np.full((4, 3), (200, 20, 20), np.uint8))
    for image in pictures.mesh_views(mesh).values():
        drawn = np.argwhere((image != pictures.BACKGROUND).any(axis=2))
        size = np.array(image.shape[:2])
        share = (drawn.max(axis=0) + 1 - drawn.min(axis=0)) / size
        assert share.max() == pytest.approx(1 - 2 * pictures.MARGIN, abs=0.02)
        assert np.abs((drawn.max(axis=0) + drawn.min(axis=0) + 1) / size - 1).max() < 0.02
        assert image[tuple(drawn[len(drawn) // 2])][0] > 2 * image[tuple(drawn[len(drawn) // 2])][1]


def test_pictures_can_be_opened(tmp_path: Path) -> None:
    write_report(make_report(0.05), tmp_path)
    files = sorted((tmp_path / "pictures").iterdir())
    assert len(files) == 10
    assert all(cv2.imread(str(file)) is not None for file in files)


def test_a_sheet_keeps_the_order_of_its_images() -> None:
    images = [np.full((30, 40, 3), 10 * i, np.uint8) for i in range(5)]
    page = pictures.sheet(images, 3)
    height, width = page.shape[0] // 2, page.shape[1] // 3
    places = [(row, column) for row in (0, 1) for column in range(3)]
    middles = [page[r * height + height // 2, c * width + width // 2, 0] for r, c in places]
    assert middles == [0, 10, 20, 30, 40, 255]


def test_depth_runs_from_yellow_to_violet_and_sky_is_grey() -> None:
    image = pictures.depth_picture(np.array([[1.0, 5.0, np.inf]], np.float32), 1.0, 5.0)
    near, far, sky = image[0].astype(int)
    assert near[0] > 200
    assert near[2] < 80
    assert far[2] > far[1]
    assert sky.tolist() == [128, 128, 128]


def test_neighbouring_instances_differ() -> None:
    colors = pictures.instance_picture(np.arange(1, 30, dtype=np.uint32)[None])[0].astype(int)
    assert np.abs(np.diff(colors, axis=0)).max(axis=1).min() > 40


@pytest.mark.parametrize("semantic_id", [0, 1, 2, 77])
def test_every_label_has_a_colour(semantic_id: int) -> None:
    assert pictures.label_color(semantic_id, {1: "a", 2: "b"}).shape == (3,)
