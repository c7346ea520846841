"""The paper's active view planning: an aerial vehicle explores a steep hill view by view.

The planner knows what it receives over ROS: depth images with their cameras and poses. What no
planner could know comes from the simulator over gRPC: the box to fly in, and the true surface,
against which coverage is counted.
"""

from __future__ import annotations

import contextlib
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import ceil, sqrt
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.types import DEPTH, FloatArray, Pose
from oaisys_mapping.evaluation.thresholds import exploration_thresholds
from oaisys_mapping.exploration.coverage_record import (
    CoverageRecord,
    comparison_lines,
    planner_results,
)
from oaisys_mapping.exploration.planner_process import PlannerProcess
from oaisys_mapping.exploration.planners import BUILT_IN_PLANNERS, make_planner, require_planner
from oaisys_mapping.exploration.planning import PlannerError
from oaisys_mapping.report.report import COVERAGE_GOAL
from oaisys_ros_bridge.experiments.bringup import (
    MAP_TIMEOUT_S,
    START_TIMEOUT_S,
    SimulatorStack,
    bring_up,
)
from oaisys_ros_bridge.experiments.configuration import MESH_FILE
from oaisys_ros_bridge.experiments.evaluation.map_evaluation import evaluate_and_certify
from oaisys_ros_bridge.experiments.explore.exploration import (
    Exploration,
    ExplorationLimits,
    explore,
    plans_of,
)
from oaisys_ros_bridge.experiments.explore.flight_area import FlightArea, flight_area
from oaisys_ros_bridge.experiments.explore.node_planner import VIEW_TIMEOUT_S, watch
from oaisys_ros_bridge.experiments.explore.plan import ExploreOptions
from oaisys_ros_bridge.experiments.explore.trajectory_client import TrajectoryClient, poses_along
from oaisys_ros_bridge.experiments.interruption import raise_if_interrupted
from oaisys_ros_bridge.experiments.planner_client import ReceivedView
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.report import ExperimentRun, write_experiment_report
from oaisys_ros_bridge.mapper.fusion import DepthFrame

MOST_FIRST_WORLDS = 3
"""Seeds that are tried for a world to begin with, before those that planners explore."""

Stack = SimulatorStack[TrajectoryClient]


def run_explore(options: ExploreOptions, reporter: Reporter) -> bool:
    """Let every planner explore every world, and write the report.

    Returns whether the map of the first planner in the first world agrees with the true surface.

    Raises:
        ConfigError: The configuration cannot be used.
        InvalidInputError: A planner does not exist, or the vehicle does not fit.
        OaisysError: A process failed, or did not answer in time.
    """
    started_s = time.monotonic()
    programs = {program.name for program in options.programs}
    for name in options.planners:
        if name not in programs:
            require_planner(name)
    with bring_up(options, TrajectoryClient, reporter, options.seeds[:MOST_FIRST_WORLDS]) as stack:
        records, mapped = _explore_all(options, stack, reporter)
        losses = stack.client.shortfalls(MAP_TIMEOUT_S)
        info = stack.simulator.info()
    seconds = time.monotonic() - started_s
    if len(options.planners) > 1:
        for line in comparison_lines(planner_results(records, COVERAGE_GOAL), COVERAGE_GOAL):
            reporter.say(line)
    area, views = mapped.area, mapped.found.views
    result = evaluate_and_certify(
        options,
        info,
        area.truth,
        [area.camera(pose) for pose in mapped.found.poses],
        [],
        exploration_thresholds(options.voxel_size_m),
        reporter,
        world_seed=mapped.record.seed,
    )
    return write_experiment_report(
        options,
        ExperimentRun(info, views, losses),
        result,
        reporter,
        title="Exploration of a rendered terrain",
        columns=ceil(sqrt(len(views) * 6 / 5)),
        facts=_facts(records, mapped.record),
        failures=[_failure(record) for record in records if record.failed],
        seconds_total=seconds,
        coverage=records,
    )


@dataclass(frozen=True)
class MappedExploration:
    """The exploration whose map is evaluated: the first one whose planner did not fail."""

    found: Exploration
    area: FlightArea
    record: CoverageRecord


def _explore_all(
    options: ExploreOptions, stack: Stack, reporter: Reporter
) -> tuple[list[CoverageRecord], MappedExploration]:
    """Return the records of all explorations, and the one whose map is saved.

    Raises:
        InvalidInputError: The vehicle fits in no world.
        PlannerError: All planners failed in all worlds; says how the first one did.
    """
    records: list[CoverageRecord] = []
    mapped: MappedExploration | None = None
    misfit: InvalidInputError | None = None
    for seed in options.seeds:
        area: FlightArea | None = None
        for name in options.planners:
            reporter.say(f"world {seed}: building it for {name}")
            try:
                stack.client.step_batch(seed, START_TIMEOUT_S)
                area = area or flight_area(options, stack.simulator, stack.sensor, seed)
            except (InvalidInputError, RenderError) as error:
                misfit = error if isinstance(error, InvalidInputError) else misfit
                records.append(_record_of_no_view(name, seed, f"no world to explore: {error}"))
                reporter.say(_failure(records[-1]))
                continue
            area.coverage.forget()
            found, coverage = _explore_world(options, stack, area, name, seed, reporter)
            records.append(record := _record(name, seed, found, coverage, stack))
            if record.failed:
                reporter.say(_failure(record))
            elif mapped is None:
                mapped = MappedExploration(found, area, record)
                _add_map_times(found, stack)
                path = str((options.out / MESH_FILE).resolve())
                stack.client.save_mesh(path, MAP_TIMEOUT_S)
                # Images are wanted of the evaluated map; planners need depth alone.
                stack.client.request_only((DEPTH,))
    if mapped is None and misfit is not None:
        raise misfit
    if mapped is None:
        raise PlannerError(f"no planner explored a world: {records[0].ended}")
    return records, mapped


def _failure(record: CoverageRecord) -> str:
    """Return how an exploration failed, in a sentence."""
    count = len(record.coverage)
    views = f"{count} view{'' if count == 1 else 's'}"
    return f"{record.planner} failed in world {record.seed} after {views}: {record.ended}"


def _explore_world(
    options: ExploreOptions,
    stack: Stack,
    area: FlightArea,
    name: str,
    seed: int,
    reporter: Reporter,
) -> tuple[Exploration, list[float]]:
    """Let a planner explore a world; return the exploration and the coverage after each view."""
    coverage: list[float] = []
    limits = ExplorationLimits(_most_views(options, name), options.path_m)

    def render(pose: Pose, path_m: FloatArray) -> tuple[ReceivedView, DepthFrame]:
        raise_if_interrupted()
        if options.via == "trajectory":
            poses = poses_along(path_m, pose)
            view, frame = stack.client.view_by_trajectory(poses, VIEW_TIMEOUT_S)
        else:
            view, frame = stack.client.view_by_service(pose, VIEW_TIMEOUT_S)
        if not coverage and not (frame.depth_m <= options.camera_range_m).any():
            position_m = ", ".join(f"{value:.1f}" for value in pose.position_m)
            reporter.say(
                f"the first view, from ({position_m}), sees no ground within "
                f"{options.camera_range_m:g} m: see --start-height, --camera-range, and the mount"
            )
        return view, frame

    def goes_on(found: Exploration) -> bool:
        coverage.append(area.coverage.add(found.poses[-1]))
        reporter.say(
            f"{name}, world {seed}, view {len(coverage)}: {coverage[-1]:.1%} seen, "
            f"{found.path_m[-1]:.0f} m flown, rendered in {found.views[-1].render_s:.2f} s"
        )
        return coverage[-1] < options.until

    for program in options.programs:
        if program.name == name:
            log = options.out / "logs" / f"{name}-{seed}.log"
            return watch(program, stack.client, area.start, limits, log, goes_on), coverage
    with contextlib.ExitStack() as planners:
        if name in BUILT_IN_PLANNERS:
            next_plan = plans_of(make_planner(name), np.random.default_rng(seed))
        else:
            process = PlannerProcess(name, seed, options.plan_timeout_s)
            next_plan = planners.enter_context(process).next_plan
        found = explore(
            render,
            next_plan,
            area.start,
            area.bounds,
            area.vehicle,
            options.planning_voxel_m,
            limits,
            goes_on,
        )
    return found, coverage


def _most_views(options: ExploreOptions, name: str) -> int:
    return options.views if name == options.planners[0] else options.baseline_views


def _add_map_times(found: Exploration, stack: Stack) -> None:
    """Add to the views how long transferring and fusing each of them took."""
    status = stack.client.status
    seconds = status.wait_for_map(len(found.views), MAP_TIMEOUT_S)
    found.views[:] = [
        replace(view, integration_s=each, transfer_s=status.transfer_s(view.stamp_ns))
        for view, each in zip(found.views, seconds, strict=True)
    ]


def _record(
    name: str, seed: int, found: Exploration, coverage: list[float], stack: Stack
) -> CoverageRecord:
    if not found.poses:
        return _record_of_no_view(name, seed, found.ended, found.refused)
    positions_m = np.array([pose.position_m for pose in found.poses])
    clearance_m = stack.simulator.query_height(positions_m).clearance_m
    known_m = clearance_m[np.isfinite(clearance_m)]
    return CoverageRecord(
        name,
        seed,
        coverage,
        found.path_m,
        plan_s=statistics.median(found.plan_s) if found.plan_s else 0.0,
        refused=found.refused,
        least_clearance_m=float(known_m.min()) if len(known_m) else None,
        ended=found.ended,
        failed=found.failed,
    )


def _record_of_no_view(name: str, seed: int, reason: str, refused: int = 0) -> CoverageRecord:
    return CoverageRecord(name, seed, [], [], 0.0, refused=refused, ended=reason, failed=True)


def _facts(records: Sequence[CoverageRecord], mapped: CoverageRecord) -> dict[str, Any]:
    """Return the entries of ``report.json`` on explorations."""
    return {
        "planner": mapped.planner,
        "coverage": list(mapped.coverage),
        "path_length_m": mapped.path_m[-1],
        "seconds_to_plan": mapped.plan_s,
        "explorations": [
            asdict(record) | {"views_to_90": record.views_to(COVERAGE_GOAL)} for record in records
        ],
        "planners": {
            result.planner: asdict(result) for result in planner_results(records, COVERAGE_GOAL)
        },
    }
