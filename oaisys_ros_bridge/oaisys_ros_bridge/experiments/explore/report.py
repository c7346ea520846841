"""The report of explorations."""

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
from oaisys_ros_bridge.experiments.configuration import CONFIG_FILE
from oaisys_ros_bridge.experiments.evaluation.map_evaluation import evaluate_and_certify
from oaisys_ros_bridge.experiments.evaluation.report_sections import tables_of
from oaisys_ros_bridge.experiments.explore.exploration import Exploration
from oaisys_ros_bridge.experiments.explore.plan import ExploreOptions
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.survey.report import (
    evaluation_facts,
    run_facts,
    say_result,
    view_record,
)


@dataclass(frozen=True)
class MappedExploration:
    """The exploration whose map is evaluated."""

    exploration: Exploration
    vehicle: Vehicle
    mesh: ColoredMesh
    truth: TriangleMesh


def write_explore_report(
    options: ExploreOptions,
    info: SimulatorInfo,
    records: Sequence[CoverageRecord],
    mapped: MappedExploration,
    seconds_total: float,
    reporter: Reporter,
    losses: Sequence[str] = (),
) -> bool:
    """Evaluate the map, write the report, and return whether the loop closes.

    It does not where ``losses`` says that mapper or recorder have lost something.
    """
    vehicle = mapped.vehicle
    views = [
        PosedCamera(vehicle.intrinsics, pose_to_matrix(pose) @ vehicle.T_base_camera)
        for pose in mapped.exploration.poses
    ]
    thresholds = exploration_thresholds(options.voxel_size_m)
    result = evaluate_and_certify(
        options,
        info,
        mapped.truth,
        views,
        [],
        thresholds,
        options.key,
        reporter,
        world_seed=records[0].seed,
    )
    received = mapped.exploration.views
    report = SurveyReport(
        title="Exploration of a rendered terrain",
        facts=run_facts(info, received, seconds_total) | _facts(records) | evaluation_facts(result),
        evaluation=result.evaluation,
        thresholds=thresholds,
        mesh=result.mesh,
        views=[view_record(view) for view in received],
        columns=ceil(sqrt(len(received) * 6 / 5)),
        labels=info.semantic_labels,
        command=shlex.join(options.command),
        config_text=(options.out / CONFIG_FILE).read_text(encoding="utf-8"),
        coverage=records,
        cameras=views,
        tables=tables_of(result),
        losses=losses,
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
