"""Writes the report of an experiment: its figures, its verdict, and how it was run."""

from __future__ import annotations

import shlex
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0, SimulatorInfo
from oaisys_mapping.exploration.coverage_record import CoverageRecord
from oaisys_mapping.report.report import SurveyReport, ViewRecord, write_report
from oaisys_ros_bridge.experiments.configuration import CONFIG_FILE, ExperimentOptions
from oaisys_ros_bridge.experiments.evaluation.map_evaluation import MapEvaluation
from oaisys_ros_bridge.experiments.evaluation.report_tables import tables_of
from oaisys_ros_bridge.experiments.planner_client import ReceivedView
from oaisys_ros_bridge.experiments.progress import Reporter


@dataclass(frozen=True)
class ExperimentRun:
    """What an experiment has received until its simulator was ended.

    Attributes:
        info: Of the simulator at its end.
        views: In order.
        losses: What mapper and recorder have lost, in sentences.
    """

    info: SimulatorInfo
    views: Sequence[ReceivedView]
    losses: Sequence[str]


def write_experiment_report(
    options: ExperimentOptions,
    run: ExperimentRun,
    result: MapEvaluation,
    reporter: Reporter,
    *,
    title: str,
    columns: int,
    facts: Mapping[str, Any],
    seconds_total: float,
    coverage: Sequence[CoverageRecord] = (),
    failures: Sequence[str] = (),
    elapsed_s: Callable[[], float] | None = None,
) -> bool:
    """Write the report, print its verdict, and return whether the map agrees with the true surface.

    It does not agree if a threshold is missed or a message was lost. A planner that failed makes
    the answer False, too.

    Args:
        options: Of the experiment.
        run: What was received.
        result: The evaluation of the map.
        reporter: Prints the verdict.
        title: Heading of the report.
        columns: Views in a row of its pictures.
        facts: Further entries of ``report.json``.
        seconds_total: Duration of the experiment.
        coverage: Of explorations.
        failures: One sentence for each exploration whose planner failed.
        elapsed_s: Returns the seconds since the start, at which the report is there; None: that is
            not told.
    """
    report = SurveyReport(
        title=title,
        facts={**_run_facts(run, seconds_total), **facts, **_evaluation_facts(result)},
        evaluation=result.evaluation,
        thresholds=result.thresholds,
        mesh=result.mesh,
        views=[_view_record(view) for view in run.views],
        columns=columns,
        labels=run.info.semantic_labels,
        command=shlex.join(options.command),
        config_text=(options.out / CONFIG_FILE).read_text(encoding="utf-8"),
        coverage=coverage,
        cameras=result.cameras,
        tables=tables_of(result),
        losses=run.losses,
        failures=failures,
        elapsed_s=elapsed_s,
    )
    figures = write_report(report, options.out)
    _say_verdict(report, options, reporter)
    if elapsed_s is not None:
        _say_times(figures, reporter)
    return not report.misses and not report.failures


def _run_facts(run: ExperimentRun, seconds_total: float) -> dict[str, Any]:
    info = run.info
    return {
        "views": len(run.views),
        "seed": info.seed,
        "config_sha256": info.config_sha256,
        "backend": info.backend,
        "backend_version": info.backend_version,
        "blender_version": info.backend_version if info.backend == "blender" else None,
        "quality": info.quality,
        "seconds_total": seconds_total,
        "seconds_per_view": statistics.median(view.service_s for view in run.views),
        "seconds_per_render": statistics.median(view.render_s for view in run.views),
    }


def _evaluation_facts(result: MapEvaluation) -> dict[str, Any]:
    return {
        "certificate_sha256": result.certificate["sha256"],
        "faults": [record.to_dict() for record in result.faults],
    }


def _view_record(view: ReceivedView) -> ViewRecord:
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


def _say_verdict(report: SurveyReport, options: ExperimentOptions, reporter: Reporter) -> None:
    figures = report.evaluation.metrics
    reporter.say(
        f"RMSE {figures.rmse_m:.4f} m, completion {figures.completion_ratio:.4f}, "
        f"F-score {figures.f_score:.4f}, holes {figures.hole_ratio:.4f}"
    )
    for sentence in report.misses:
        reporter.say(f"missed: {sentence}")
    verdict = "does not agree" if report.misses else "agrees"
    reporter.say(f"the map {verdict} with the true surface: {options.out / 'report.html'}")


def _say_times(figures: Mapping[str, Any], reporter: Reporter) -> None:
    picture_s, report_s = figures["seconds_to_first_picture"], figures["seconds_to_report"]
    picture = "no picture" if picture_s is None else f"first picture after {picture_s:.0f} s"
    reporter.say(f"{picture}, report after {report_s:.0f} s")
