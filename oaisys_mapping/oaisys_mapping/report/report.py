"""The report of a survey: ``report.json`` for programs and ``report.html`` for people."""

from __future__ import annotations

import base64
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
import numpy as np
import open3d as o3d
import scipy
from numpy.typing import NDArray

from oaisys_core.files.whole_files import write_whole_text
from oaisys_core.types import ShortRepr
from oaisys_mapping.evaluation.evaluate import Evaluation
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.exploration.coverage_record import CoverageRecord, planner_results
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report import pictures
from oaisys_mapping.report.figure_names import figure_name
from oaisys_mapping.report.mesh_viewer import decimate, layers_of, pack_mesh
from oaisys_mapping.report.three_js import load_three

COVERAGE_GOAL = 0.9
"""Coverage at which planners are compared."""


@dataclass(frozen=True, repr=False)
class ViewRecord(ShortRepr):
    """The images and times of one viewpoint.

    Attributes:
        rgb, depth_m, semantic_ids, instance_ids: The images received, any of them None.
        seconds: Seconds by kind of work.
    """

    rgb: NDArray[np.uint8] | None
    depth_m: NDArray[np.float32] | None
    semantic_ids: NDArray[np.uint16] | None
    instance_ids: NDArray[np.uint32] | None
    seconds: Mapping[str, float]


@dataclass(frozen=True)
class ReportTable:
    """An additional table of a report.

    Attributes:
        title: Heading.
        note: Explanation below the table.
        header: Titles of the columns.
        rows: Formatted cells.
    """

    title: str
    note: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class SurveyReport:
    """Everything that a report shows.

    Attributes:
        title: Heading.
        facts: Facts for both reports: seed, versions, counts, times.
        evaluation: The figures, and the points they were computed from.
        thresholds: The thresholds of a closed survey.
        mesh: The reconstruction.
        views: One record per viewpoint, in order.
        columns: Viewpoints in a row of the survey's grid.
        labels: Names of semantic ids.
        command: Command that repeats the run.
        config_text: The whole configuration.
        coverage: Records of explorations; empty for a survey.
        cameras: Cameras that are drawn with the mesh.
        tables: Additional tables, below the verdict.
        losses: One sentence for each kind of data that was lost in transport.
        failures: One sentence for each exploration whose planner failed.
        elapsed_s: Returns the seconds since the start, for ``seconds_to_report``; None: without.
    """

    title: str
    facts: Mapping[str, Any]
    evaluation: Evaluation
    thresholds: Thresholds
    mesh: ColoredMesh
    views: Sequence[ViewRecord]
    columns: int
    labels: Mapping[int, str]
    command: str
    config_text: str
    coverage: Sequence[CoverageRecord] = ()
    cameras: Sequence[PosedCamera] = ()
    tables: Sequence[ReportTable] = ()
    losses: Sequence[str] = ()
    failures: Sequence[str] = ()
    elapsed_s: Callable[[], float] | None = None

    @property
    def misses(self) -> list[str]:
        """One sentence for each missed threshold and each loss."""
        return [*self.thresholds.misses_of(self.evaluation.metrics), *self.losses]


def write_report(report: SurveyReport, out: Path) -> dict[str, Any]:
    """Write ``report.html``, its pictures and ``report.json`` below ``out``; return the latter."""
    figures = {
        **report.facts,
        **report.evaluation.metrics.to_dict(),
        "closed": not report.misses,
        "missed": report.misses,
        "lost": list(report.losses),
        "failed": list(report.failures),
        "thresholds": asdict(report.thresholds),
        "versions": versions(),
    }
    images = _pictures(report)
    folder = out / "pictures"
    folder.mkdir(exist_ok=True)
    for name, data in images.items():
        (folder / name).write_bytes(data)
    write_whole_text(out / "report.html", _html(report, figures, images))
    if report.elapsed_s is not None:
        figures["seconds_to_report"] = report.elapsed_s()
    write_whole_text(out / "report.json", json.dumps(figures, indent=2))
    return figures


def versions() -> dict[str, str]:
    """Return the versions of the software that evaluated and drew."""
    libraries = {"open3d": o3d, "numpy": np, "scipy": scipy, "matplotlib": mpl}
    return {
        "oaisys_mapping": metadata.version("oaisys_mapping"),
        "python": platform.python_version(),
        **{name: str(library.__version__) for name, library in libraries.items()},
        "platform": platform.platform(),
    }


def _pictures(report: SurveyReport) -> dict[str, bytes]:
    """Return the image files by name."""
    found = report.evaluation
    voxel_m = found.metrics.voxel_size_m
    files = {
        f"mesh_{index}.jpg": pictures.jpeg(image)
        for index, image in enumerate(pictures.mesh_views(report.mesh).values())
    }
    files.update(_sheets(report))
    files["error_map.png"] = pictures.distance_map(
        found.reconstruction.points_m,
        found.reconstruction_distance_m,
        2 * voxel_m,
        voxel_m / 2,
        "From the reconstruction to the truth",
    )
    files["missing_map.png"] = pictures.distance_map(
        found.visible_truth.points_m,
        found.visible_truth_distance_m,
        2 * voxel_m,
        voxel_m,
        "From the visible truth to the reconstruction",
    )
    if report.coverage:
        files["coverage.png"] = pictures.coverage_chart(
            [
                (f"{run.planner}, world {run.seed}", run.coverage, run.path_m)
                for run in report.coverage
            ],
            COVERAGE_GOAL,
        )
    names = list(report.views[0].seconds)
    files["time.png"] = pictures.time_chart(
        {name: [view.seconds[name] for view in report.views] for name in names}
    )
    return files


def _sheets(report: SurveyReport) -> dict[str, bytes]:
    """Return the contact sheets by file name."""
    files = {}
    rgb = [view.rgb for view in report.views if view.rgb is not None]
    if rgb:
        files["sheet_rgb.jpg"] = pictures.jpeg(pictures.sheet(rgb, report.columns))
    depth_m = [view.depth_m for view in report.views if view.depth_m is not None]
    if depth_m:
        near_m, far_m = depth_range_m(depth_m)
        images = [pictures.depth_picture(image, near_m, far_m) for image in depth_m]
        files["sheet_depth.jpg"] = pictures.jpeg(pictures.sheet(images, report.columns))
    semantic = [view.semantic_ids for view in report.views if view.semantic_ids is not None]
    if semantic:
        images = [pictures.semantic_picture(ids, report.labels) for ids in semantic]
        files["sheet_semantic.png"] = pictures.png(pictures.sheet(images, report.columns))
    instance = [view.instance_ids for view in report.views if view.instance_ids is not None]
    if instance:
        images = [pictures.instance_picture(ids) for ids in instance]
        files["sheet_instance.png"] = pictures.png(pictures.sheet(images, report.columns))
    return files


def depth_range_m(images: Sequence[NDArray[np.float32]]) -> tuple[float, float]:
    """Return the depth range of a sheet's colours: the middle 98 % of all pixels."""
    finite = np.concatenate([image[np.isfinite(image)][::17] for image in images])
    if not len(finite):
        return 0.0, 1.0
    near_m, far_m = np.percentile(finite, (1, 99))
    return float(near_m), float(far_m)


def _html(report: SurveyReport, figures: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("oaisys_mapping", "templates"), autoescape=True
    )
    environment.filters["figure_name"] = figure_name
    depth_m = [view.depth_m for view in report.views if view.depth_m is not None]
    legend = [
        (name, "#" + pictures.label_color(semantic_id, report.labels).tobytes().hex())
        for semantic_id, name in sorted(report.labels.items())
    ]
    return environment.get_template("report.html.j2").render(
        report=report,
        figures=figures,
        metrics=report.evaluation.metrics,
        images={name: data_url(name, data) for name, data in images.items()},
        mesh_sides=list(pictures.MESH_SIDES),
        legend=legend,
        criteria=report.thresholds.criteria_of(report.evaluation.metrics),
        depth_ticks_m=np.linspace(*depth_range_m(depth_m), 5).tolist() if depth_m else [],
        planners=planner_results(report.coverage, COVERAGE_GOAL),
        goal=COVERAGE_GOAL,
        viewer=_viewer(report),
        depth_scale=data_url("scale.png", pictures.png(pictures.depth_scale())),
    )


def _viewer(report: SurveyReport) -> dict[str, Any] | None:
    """Return the parts of the interactive mesh viewer; None if three.js is not installed."""
    three = load_three()
    if three is None:
        return None
    mesh = decimate(report.mesh)
    layers = layers_of(mesh, report.evaluation, report.labels)
    script = resources.files("oaisys_mapping") / "templates" / "mesh_viewer.js"
    return {
        "three": three,
        "triangles": len(mesh.triangles),
        "script": script.read_text(encoding="utf-8"),
        **pack_mesh(mesh, layers, report.cameras),
    }


def data_url(name: str, data: bytes) -> str:
    """Return an image file as a link that holds it."""
    kind = "jpeg" if name.endswith(".jpg") else "png"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
