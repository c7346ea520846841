"""What explorations found, as the mapping package's report takes it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import ceil, sqrt
from typing import Any

from oaisys_core.geometry import pose_to_matrix
from oaisys_core.types import SimulatorInfo, TriangleMesh
from oaisys_mapping.evaluation.thresholds import exploration_thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.exploration.coverage_record import CoverageRecord, planner_results
from oaisys_mapping.exploration.planner import Vehicle
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report.report import COVERAGE_GOAL, SurveyReport, write_report
from oaisys_ros_bridge.experiments.evaluation.evaluation import measure_and_certify
from oaisys_ros_bridge.experiments.evaluation.report_sections import sections_of
from oaisys_ros_bridge.experiments.explore.explorer import Exploration
from oaisys_ros_bridge.experiments.explore.plan import ExploreOptions
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.survey.report import (
    closure_facts,
    run_facts,
    say_result,
    view_record,
)
from oaisys_ros_bridge.experiments.system import CONFIG_FILE


@dataclass(frozen=True)
class Measured:
    """The exploration whose map is measured."""

    found: Exploration
    vehicle: Vehicle
    mesh: ColoredMesh
    truth: TriangleMesh


def write_explore_report(
    options: ExploreOptions,
    info: SimulatorInfo,
    records: Sequence[CoverageRecord],
    measured: Measured,
    seconds_total: float,
    reporter: Reporter,
    lacks: Sequence[str] = (),
) -> bool:
    """Measure the map, write everything to the output folder, and return whether it closes.

    It does not where something is missing: ``lacks`` is what mapper and recorder have lost.
    """
    vehicle = measured.vehicle
    views = [
        PosedCamera(vehicle.intrinsics, pose_to_matrix(pose) @ vehicle.T_base_camera)
        for pose in measured.found.poses
    ]
    thresholds = exploration_thresholds(options.voxel_size_m)
    closure = measure_and_certify(
        options,
        info,
        measured.truth,
        views,
        [],
        thresholds,
        options.key,
        reporter,
        world_seed=records[0].seed,
    )
    received = measured.found.views
    report = SurveyReport(
        title="Exploration of a rendered terrain",
        facts=run_facts(info, received, seconds_total) | _facts(records) | closure_facts(closure),
        evaluation=closure.evaluation,
        thresholds=thresholds,
        mesh=closure.mesh,
        views=[view_record(view) for view in received],
        columns=ceil(sqrt(len(received) * 6 / 5)),
        labels=info.semantic_labels,
        command=shlex.join(options.command),
        config_text=(options.out / CONFIG_FILE).read_text(encoding="utf-8"),
        coverage=records,
        cameras=views,
        tables=sections_of(closure),
        losses=lacks,
    )
    write_report(report, options.out)
    say_result(report, options, reporter)
    return not report.missed


def _facts(records: Sequence[CoverageRecord]) -> dict[str, Any]:
    first = records[0]
    return {
        "planner": first.planner,
        "coverage": list(first.coverage),
        "path_length_m": first.path_m[-1],
        "seconds_to_plan": first.plan_s,
        "explorations": [
            asdict(record) | {"views_to_90": record.views_to(COVERAGE_GOAL)} for record in records
        ],
        "planners": {
            result.planner: asdict(result) for result in planner_results(records, COVERAGE_GOAL)
        },
    }
