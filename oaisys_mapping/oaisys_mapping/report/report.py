"""What a survey found, as ``report.json`` for programs and ``report.html`` for people."""

from __future__ import annotations

import base64
import json
import platform
from collections.abc import Mapping, Sequence
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

from oaisys_core.types import ShortRepr
from oaisys_mapping.evaluation.evaluate import Evaluation
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.exploration.coverage_record import CoverageRecord, planner_results
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report import pictures
from oaisys_mapping.report.mesh_viewer import layers_of, packed, thinned
from oaisys_mapping.report.three_js import load_three

COVERAGE_GOAL = 0.9
"""Coverage for which planners are compared."""


@dataclass(frozen=True, repr=False)
class ViewRecord(ShortRepr):
    """What came back for one viewpoint.

    Attributes:
        rgb, depth_m, semantic_ids, instance_ids: The images received, any of them None.
        seconds: Where the time went, by name, in seconds.
    """

    rgb: NDArray[np.uint8] | None
    depth_m: NDArray[np.float32] | None
    semantic_ids: NDArray[np.uint16] | None
    instance_ids: NDArray[np.uint32] | None
    seconds: Mapping[str, float]


@dataclass(frozen=True)
class ReportTable:
    """A table that only some reports have.

    Attributes:
        title: Its heading.
        note: What it tells.
        header: Of its columns.
        rows: Its cells, as they are to be read.
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
        facts: What was run, for both reports: seed, versions, counts, times.
        evaluation: Figures, and the points they were taken from.
        thresholds: What counts as closed.
        mesh: The reconstruction.
        views: One per viewpoint, in order.
        columns: Viewpoints in a row of the survey's grid.
        labels: Names of semantic ids.
        command: How to run it again.
        config_text: The whole configuration.
        coverage: Of explorations; none for a survey.
        cameras: From where the mesh was seen; drawn with it.
        tables: Further tables, below the verdict.
        losses: What was lost of the samples on their way, one sentence each.
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

    @property
    def missed(self) -> list[str]:
        """One sentence per threshold that is missed, and all that was lost."""
        return [*self.thresholds.missed_by(self.evaluation.metrics), *self.losses]


def write_report(report: SurveyReport, out: Path) -> None:
    """Write ``report.json``, ``report.html`` and the pictures below ``out``."""
    figures = {
        **report.facts,
        **report.evaluation.metrics.to_dict(),
        "closed": not report.missed,
        "missed": report.missed,
        "lost": list(report.losses),
        "thresholds": asdict(report.thresholds),
        "versions": _versions(),
    }
    (out / "report.json").write_text(json.dumps(figures, indent=2), encoding="utf-8")
    images = _pictures(report)
    folder = out / "pictures"
    folder.mkdir(exist_ok=True)
    for name, data in images.items():
        (folder / name).write_bytes(data)
    (out / "report.html").write_text(_html(report, figures, images), encoding="utf-8")


def _versions() -> dict[str, str]:
    """Return the versions of what measured and drew."""
    libraries = {"open3d": o3d, "numpy": np, "scipy": scipy, "matplotlib": mpl}
    return {
        "oaisys_mapping": metadata.version("oaisys_mapping"),
        "python": platform.python_version(),
        **{name: str(library.__version__) for name, library in libraries.items()},
        "platform": platform.platform(),
    }


def _pictures(report: SurveyReport) -> dict[str, bytes]:
    """Return image files by name."""
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
    """Return contact sheets by file name."""
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
    """Return the range of depth that a sheet's colours span: the middle 98 % of all pixels."""
    finite = np.concatenate([image[np.isfinite(image)][::17] for image in images])
    if not len(finite):
        return 0.0, 1.0
    near_m, far_m = np.percentile(finite, (1, 99))
    return float(near_m), float(far_m)


def _html(report: SurveyReport, figures: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("oaisys_mapping", "templates"), autoescape=True
    )
    depth_m = [view.depth_m for view in report.views if view.depth_m is not None]
    legend = [
        (name, "#" + pictures.label_color(semantic_id, report.labels).tobytes().hex())
        for semantic_id, name in sorted(report.labels.items())
    ]
    return environment.get_template("report.html.j2").render(
        report=report,
        figures=figures,
        metrics=report.evaluation.metrics,
        images={name: _data_url(name, data) for name, data in images.items()},
        mesh_sides=list(pictures.MESH_SIDES),
        legend=legend,
        criteria=report.thresholds.applied_to(report.evaluation.metrics),
        depth_ticks_m=np.linspace(*depth_range_m(depth_m), 5).tolist() if depth_m else [],
        planners=planner_results(report.coverage, COVERAGE_GOAL),
        goal=COVERAGE_GOAL,
        viewer=_viewer(report),
        depth_scale=_data_url("scale.png", pictures.png(pictures.depth_scale())),
    )


def _viewer(report: SurveyReport) -> dict[str, Any] | None:
    """Return what the page needs to draw a mesh that turns; None where three.js is missing."""
    three = load_three()
    if three is None:
        return None
    mesh = thinned(report.mesh)
    layers = layers_of(mesh, report.evaluation, report.labels)
    script = resources.files("oaisys_mapping") / "templates" / "mesh_viewer.js"
    return {
        "three": three,
        "triangles": len(mesh.triangles),
        "script": script.read_text(encoding="utf-8"),
        **packed(mesh, layers, report.cameras),
    }


def _data_url(name: str, data: bytes) -> str:
    kind = "jpeg" if name.endswith(".jpg") else "png"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
