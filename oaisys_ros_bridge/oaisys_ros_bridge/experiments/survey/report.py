"""The report of a survey."""

from __future__ import annotations

import shlex
import statistics
from collections.abc import Sequence
from typing import Any

from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0, SimulatorInfo
from oaisys_mapping.evaluation.thresholds import survey_thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.report.report import SurveyReport, ViewRecord
from oaisys_ros_bridge.experiments.configuration import CONFIG_FILE, ExperimentOptions
from oaisys_ros_bridge.experiments.evaluation.map_evaluation import MapEvaluation
from oaisys_ros_bridge.experiments.evaluation.report_sections import tables_of
from oaisys_ros_bridge.experiments.planner_client import ReceivedView
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.survey.plan import SurveyOptions, survey_columns


def survey_report(
    options: SurveyOptions,
    info: SimulatorInfo,
    result: MapEvaluation,
    views: Sequence[PosedCamera],
    received: Sequence[ReceivedView],
    seconds_total: float,
    losses: Sequence[str] = (),
) -> SurveyReport:
    """Return the report; ``losses`` says what mapper and recorder have lost."""
    return SurveyReport(
        title="Survey of a rendered terrain",
        facts=run_facts(info, received, seconds_total)
        | {"altitude_m": options.altitude_m, "overlap": options.overlap}
        | evaluation_facts(result),
        evaluation=result.evaluation,
        thresholds=survey_thresholds(options.voxel_size_m),
        mesh=result.mesh,
        views=[view_record(view) for view in received],
        columns=survey_columns(options.views),
        labels=info.semantic_labels,
        command=shlex.join(options.command),
        config_text=(options.out / CONFIG_FILE).read_text(encoding="utf-8"),
        cameras=views,
        tables=tables_of(result),
        losses=losses,
    )


def evaluation_facts(result: MapEvaluation) -> dict[str, Any]:
    """Return the entries of ``report.json`` on the certificate and the perturbation test."""
    return {
        "certificate_sha256": result.certificate["sha256"],
        "faults": [record.to_dict() for record in result.faults],
    }


def run_facts(
    info: SimulatorInfo, received: Sequence[ReceivedView], seconds_total: float
) -> dict[str, Any]:
    """Return the entries of ``report.json`` on how an experiment was run."""
    is_blender = info.backend == "blender"
    return {
        "views": len(received),
        "seed": info.seed,
        "config_sha256": info.config_sha256,
        "backend": info.backend,
        "backend_version": info.backend_version,
        "blender_version": info.backend_version if is_blender else None,
        "quality": info.quality,
        "seconds_total": seconds_total,
        "seconds_per_view": statistics.median(view.service_s for view in received),
        "seconds_per_render": statistics.median(view.render_s for view in received),
    }


def view_record(view: ReceivedView) -> ViewRecord:
    """Return a view as the report shows it."""
    images = view.images
    return ViewRecord(
        rgb=images.get(RGB),
        depth_m=images.get(DEPTH),
        semantic_ids=images.get(SEMANTIC_0),
        instance_ids=images.get(INSTANCE),
        seconds={
            "render": view.render_s,
            "transfer": view.transfer_s,
            "publish": max(view.service_s - view.render_s - view.transfer_s, 0.0),
            "integrate": view.integration_s,
        },
    )


def say_result(report: SurveyReport, options: ExperimentOptions, reporter: Reporter) -> None:
    """Print the figures and the verdict."""
    figures = report.evaluation.metrics
    reporter.say(
        f"RMSE {figures.rmse_m:.4f} m, completion {figures.completion_ratio:.4f}, "
        f"F-score {figures.f_score:.4f}, holes {figures.hole_ratio:.4f}"
    )
    for sentence in report.missed:
        reporter.say(f"missed: {sentence}")
    verdict = "does not close" if report.missed else "closes"
    reporter.say(f"the loop {verdict}: {options.out / 'report.html'}")
