"""The report: its content, and that one file shows it without a network."""

import gzip
import json
import re
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from browser import Page, browser_page

from oaisys_core.types import TriangleMesh
from oaisys_mapping.evaluation.evaluate import evaluate_reconstruction
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report import pictures
from oaisys_mapping.report.drive_report import log_depth_pictures
from oaisys_mapping.report.figure_names import figure_name
from oaisys_mapping.report.mesh_viewer import Layer, decimate, pack_mesh
from oaisys_mapping.report.report import SurveyReport, ViewRecord, write_report
from oaisys_mapping.report.three_js import FOLDER_VARIABLE, load_three


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
        {"render": 0.5, "transfer": 0.04, "publish": 0.06},
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


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report whose survey closes."""
    folder = tmp_path_factory.mktemp("report")
    write_report(make_report(0.05), folder)
    return folder


def test_the_page_is_self_contained(written: Path) -> None:
    page = (written / "report.html").read_text(encoding="utf-8")
    parts = (
        "The map agrees with the true surface",
        "20.0 mm",
        "✓ RMSE, m",
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
    without_data = re.sub(r"[A-Za-z0-9+/=]{200,}", "", page)
    assert "http" not in without_data
    assert len(without_data) < 100_000


def test_the_page_leads_with_the_mesh_and_folds_what_few_read(written: Path) -> None:
    page = (written / "report.html").read_text(encoding="utf-8")
    parts = ('alt="The mesh', "The views, as received", "The map agrees", "20.0 mm", "<details>")
    places = [page.index(part) for part in parts]
    assert places == sorted(places)
    assert page.index("Expected and found") < places[-1] < page.index("Completion share")


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("rmse_m", "RMSE, m"),
        ("surveyed_area_m2", "Surveyed area, m²"),
        ("f_score", "F-score"),
        ("least_iou", "Least IoU"),
        ("seconds_per_view", "Seconds per view"),
        ("m", "M"),
    ],
)
def test_figures_have_names_with_units(key: str, name: str) -> None:
    assert figure_name(key) == name


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    if load_three() is None:
        pytest.skip("three.js is not installed: set-up found no npm")
    with browser_page(tmp_path / "browser") as page:
        yield page


def test_the_mesh_can_be_turned_in_a_browser_offline(page: Page, written: Path) -> None:
    page.open((written / "report.html").as_uri())
    assert page.wait_for("document.getElementById('viewer')?.dataset.state") == "ready"
    page.value("document.getElementById('viewer').scrollIntoView()")

    def share_of(color: tuple[int, int, int]) -> float:
        left, top, width, height = page.value(
            "(({x, y, width, height}) => [x, y, width, height].map(Math.round))"
            "(document.querySelector('#viewer canvas').getBoundingClientRect())"
        )
        shown = page.picture()[top : top + height, left : left + width].astype(int)
        return float((np.abs(shown - color).max(axis=2) < 12).mean())

    # A square seen from the side fills a good part of the canvas, and the rest is page.
    assert 0.15 < share_of((120, 120, 120)) < 0.6
    assert share_of(pictures.BACKGROUND) > 0.3
    # 2 cm wrong on a scale to 5 cm.
    page.value("[...document.querySelectorAll('#viewer-buttons button')][1].click()")
    assert page.value("document.getElementById('viewer').dataset.layer") == "error"
    assert share_of((120, 120, 120)) < 0.01
    assert share_of(pictures.BACKGROUND) < 0.85
    assert page.errors == []
    assert {urlsplit(address).scheme for address in page.requests} == {"file", "data"}
    assert sum(address.startswith("file:") for address in page.requests) == 1


def test_without_three_js_the_page_shows_pictures_and_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "nowhere"))
    write_report(make_report(0.05), tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "three.js was not installed" in page
    assert "<script" not in page


def hills(count: int) -> ColoredMesh:
    """A grid of two triangles a cell over 10 m x 10 m, red in the west and blue in the east."""
    x, y = np.meshgrid(*[np.linspace(0, 10, count + 1)] * 2, indexing="ij")
    vertices_m = np.column_stack((x.ravel(), y.ravel(), np.sin(x).ravel()))
    a = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    b, c, d = a + count + 1, a + count + 2, a + 1
    triangles = np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    west = vertices_m[:, 0] < 5
    colors = np.where(west[:, None], (200, 0, 0), (0, 0, 200)).astype(np.uint8)
    ids = np.where(west, 1, 2).astype(np.uint16)
    return ColoredMesh(vertices_m, triangles.astype(np.int32), colors, ids)


def test_thinned_meshes_keep_shape_colour_and_classes() -> None:
    mesh = decimate(hills(200), 8_000)
    assert 4_000 < len(mesh.triangles) <= 8_000
    np.testing.assert_allclose(mesh.vertices_m[:, 2], np.sin(mesh.vertices_m[:, 0]), atol=0.02)
    assert mesh.vertices_m[:, :2].min() < 0.1
    assert mesh.vertices_m[:, :2].max() > 9.9
    west = mesh.vertices_m[:, 0] < 4.8
    assert (mesh.colors_rgb[west] == (200, 0, 0)).all()
    assert mesh.class_ids is not None
    assert (mesh.class_ids[west] == 1).all()
    assert decimate(mesh, 8_000) is mesh


def test_a_packed_mesh_unpacks_within_the_quantization_step() -> None:
    mesh = hills(9)
    inverse = np.invert(mesh.colors_rgb)
    layers = [Layer("one", "", mesh.colors_rgb), Layer("</script>", "", inverse)]
    found = pack_mesh(mesh, layers, [])
    assert "<" not in found["header"]
    header, body = json.loads(found["header"]), gzip.decompress(b64decode(found["body"]))
    counts = [12 * header["triangles"], 6 * header["vertices"], *[3 * header["vertices"]] * 2]
    parts = np.split(np.frombuffer(body, np.uint8), np.cumsum(counts))
    assert not len(parts[-1])
    numbers = np.cumsum(parts[0].view(np.int32)).reshape(-1, 3)
    np.testing.assert_array_equal(numbers, mesh.triangles)
    steps = parts[1].view(np.uint16).reshape(-1, 3) / 65535
    positions_m = steps * header["size"] + header["low"]
    np.testing.assert_allclose(positions_m, mesh.vertices_m, atol=10 / 65535)
    np.testing.assert_array_equal(parts[2].reshape(-1, 3), mesh.colors_rgb)
    np.testing.assert_array_equal(parts[3].reshape(-1, 3), inverse)
    assert header["layers"][1]["title"] == "</script>"


def test_a_missed_threshold_is_shown_in_both_reports(tmp_path: Path) -> None:
    write_report(make_report(0.01), tmp_path)
    figures = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert figures["closed"] is False
    assert "rmse_m" in figures["missed"][0]
    assert figures["thresholds"]["max_rmse_m"] == 0.01
    assert figures["versions"]["numpy"] == np.__version__
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "does not agree with the true surface" in page
    assert "RMSE, m: 0.02, expected at most 0.01" in page
    assert "✗ RMSE, m" in page


def test_a_survey_with_lost_samples_does_not_close(tmp_path: Path) -> None:
    lost = "/oaisys_mapper: 2 of 30 samples are incomplete; lost: /tf 2"
    write_report(replace(make_report(0.05), losses=[lost]), tmp_path)
    figures = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert (figures["closed"], figures["lost"], figures["missed"]) == (False, [lost], [lost])
    assert lost in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_report_json_has_the_documented_keys(written: Path) -> None:
    report = make_report(0.05)
    figures = json.loads((written / "report.json").read_text(encoding="utf-8"))
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


def test_pictures_can_be_opened(written: Path) -> None:
    files = sorted((written / "pictures").iterdir())
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


def test_the_ground_before_a_rover_has_many_colours_beside_a_far_horizon() -> None:
    ground_m = np.geomspace(2.0, 20.0, 100, dtype=np.float32)
    horizon_m = np.full(20, 2000.0, np.float32)
    (image,) = log_depth_pictures([np.concatenate((ground_m, horizon_m, [np.inf]))[None]])
    assert len(np.unique(image[0, :100], axis=0)) > 50
    assert image[0, -1].tolist() == [128, 128, 128]


def test_neighbouring_instances_differ() -> None:
    colors = pictures.instance_picture(np.arange(1, 30, dtype=np.uint32)[None])[0].astype(int)
    assert np.abs(np.diff(colors, axis=0)).max(axis=1).min() > 40


@pytest.mark.parametrize("semantic_id", [0, 1, 2, 77])
def test_every_label_has_a_colour(semantic_id: int) -> None:
    assert pictures.label_color(semantic_id, {1: "a", 2: "b"}).shape == (3,)
