"""The paper's active view planning: an aerial vehicle looks at a steep hill view by view.

The planner knows what ROS gave it: depth images with their cameras and poses. The simulator's own
interface is asked for what no planner could know: the box to fly in, and the true surface, against
which coverage is counted.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from oaisys_core.errors import OaisysError
from oaisys_core.types import DEPTH, FloatArray, Pose, TriangleMesh
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_mapping.exploration.coverage import SurfaceCoverage, random_poses
from oaisys_mapping.exploration.coverage_record import CoverageRecord
from oaisys_mapping.exploration.occupancy_map import Bounds
from oaisys_mapping.exploration.planner import Vehicle
from oaisys_mapping.exploration.planners import make_planner
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import read_ply
from oaisys_mapping.voxels.rectification import rectified_camera
from oaisys_ros_bridge.experiments.explore.explorer import (
    Exploration,
    ExplorationLimits,
    ExplorerClient,
    explore,
    poses_along,
)
from oaisys_ros_bridge.experiments.explore.plan import ExploreOptions, flight_box, start_pose
from oaisys_ros_bridge.experiments.explore.report import Measured, write_explore_report
from oaisys_ros_bridge.experiments.interruption import raise_if_interrupted
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.survey_client import ReceivedView
from oaisys_ros_bridge.experiments.system import (
    MAP_TIMEOUT_S,
    START_TIMEOUT_S,
    System,
    running_system,
)
from oaisys_ros_bridge.mapper.fusion import DepthFrame

VIEW_TIMEOUT_S = 300.0

ANYWHERE_POSES = 600
"""Random poses in truly free space: what none of them sees counts as out of reach."""

COVERAGE_SPACING_M = 0.4
"""A point of the true surface stands for the square of this."""


def run_explore(options: ExploreOptions, reporter: Reporter) -> bool:
    """Let every planner explore every world, write the report, return whether the map closes.

    The map that is measured is that of the first planner in the first world.

    Raises:
        ConfigError: The configuration cannot be used.
        InvalidInputError: There is no planner of some name, or the vehicle does not fit.
        OaisysError: A process failed, or did not answer in time.
    """
    started_s = time.monotonic()
    for name in options.planners:
        make_planner(name)
    records: list[CoverageRecord] = []
    measured: Measured | None = None
    with running_system(options, ExplorerClient, reporter) as system:
        for seed in options.seeds:
            flight: Flight | None = None
            for name in options.planners:
                reporter.say(f"world {seed}: building it for {name}")
                system.client.step_batch(seed, START_TIMEOUT_S)
                flight = flight or _flight(options, system, seed)
                flight.coverage.forget()
                # Pictures are wanted of the map that is measured; planners need depth alone.
                if measured is not None:
                    system.client.ask_only_for((DEPTH,))
                found, coverage = _explored(options, system, flight, name, seed, reporter)
                records.append(_record(name, seed, found, coverage, system))
                if measured is None:
                    _note_integration(found, system)
                    mesh = _saved_map(options, system)
                    measured = Measured(found, flight.vehicle, mesh, flight.truth)
        lacks = system.client.shortfalls(MAP_TIMEOUT_S)
        info = system.simulator.info()
    assert measured is not None
    seconds = time.monotonic() - started_s
    return write_explore_report(options, info, records, measured, seconds, reporter, lacks)


@dataclass(frozen=True)
class Flight:
    """Where a vehicle flies in one world, and what there is to see."""

    vehicle: Vehicle
    bounds: Bounds
    start: Pose
    truth: TriangleMesh
    coverage: SurfaceCoverage


def _flight(options: ExploreOptions, system: System[ExplorerClient], seed: int) -> Flight:
    simulator, sensor = system.simulator, system.sensor
    extent_m = simulator.info().stage_extent_m
    if extent_m is None:
        raise OaisysError("the simulator has no world")
    vehicle = Vehicle(
        rectified_camera(sensor.intrinsics),
        sensor.T_base_camera,
        options.vehicle_radius_m,
        options.camera_range_m,
    )
    height_m = _heights_of(simulator)
    bounds = flight_box(extent_m, height_m)
    start = start_pose(bounds, height_m, options.start_height_m, vehicle)
    truth = simulator.ground_truth_mesh()
    rng = np.random.default_rng(seed)

    def clearance_m(points_m: FloatArray) -> FloatArray:
        return simulator.query_height(points_m).clearance_m

    anywhere = random_poses(bounds, vehicle, clearance_m, ANYWHERE_POSES, rng)
    coverage = SurfaceCoverage(truth, vehicle, anywhere, COVERAGE_SPACING_M, rng)
    return Flight(vehicle, bounds, start, truth, coverage)


def _heights_of(simulator: SimulatorClient) -> Callable[[FloatArray], FloatArray]:
    def height_m(xy_m: FloatArray) -> FloatArray:
        points_m = np.column_stack((xy_m, np.zeros(len(xy_m))))
        return simulator.query_height(points_m).surface_height_m

    return height_m


def _explored(
    options: ExploreOptions,
    system: System[ExplorerClient],
    flight: Flight,
    name: str,
    seed: int,
    reporter: Reporter,
) -> tuple[Exploration, list[float]]:
    """Let a planner explore a world; return what it did and its coverage after each view."""
    coverage: list[float] = []

    def look(pose: Pose, way_m: FloatArray) -> tuple[ReceivedView, DepthFrame]:
        raise_if_interrupted()
        if options.via == "trajectory":
            return system.client.fly(poses_along(way_m, pose), VIEW_TIMEOUT_S)
        return system.client.look(pose, "", VIEW_TIMEOUT_S)

    def goes_on(found: Exploration) -> bool:
        coverage.append(flight.coverage.add(found.poses[-1]))
        reporter.say(
            f"{name}, world {seed}, view {len(coverage)}: {coverage[-1]:.1%} seen, "
            f"{found.path_m[-1]:.0f} m flown, rendered in {found.views[-1].render_s:.2f} s"
        )
        return coverage[-1] < options.until

    found = explore(
        look,
        make_planner(name),
        flight.start,
        flight.bounds,
        flight.vehicle,
        options.planning_voxel_m,
        ExplorationLimits(_most_views(options, name), options.path_m),
        np.random.default_rng(seed),
        goes_on,
    )
    return found, coverage


def _saved_map(options: ExploreOptions, system: System[ExplorerClient]) -> ColoredMesh:
    path = options.out / "mesh.ply"
    system.client.save_mesh(str(path.resolve()), MAP_TIMEOUT_S)
    return read_ply(path)


def _most_views(options: ExploreOptions, name: str) -> int:
    return options.views if name == options.planners[0] else options.baseline_views


def _note_integration(found: Exploration, system: System[ExplorerClient]) -> None:
    """Complete the views with what transfer and fusing of each of them took."""
    seconds = system.client.wait_for_map(len(found.views), MAP_TIMEOUT_S)
    found.views[:] = [
        replace(view, integration_s=each, transfer_s=system.client.transfer_s(view))
        for view, each in zip(found.views, seconds, strict=True)
    ]


def _record(
    name: str,
    seed: int,
    found: Exploration,
    coverage: list[float],
    system: System[ExplorerClient],
) -> CoverageRecord:
    places_m = np.array([pose.position_m for pose in found.poses])
    clearance_m = system.simulator.query_height(places_m).clearance_m
    return CoverageRecord(
        name,
        seed,
        coverage,
        found.path_m,
        plan_s=statistics.median(found.plan_s) if found.plan_s else 0.0,
        refused=found.refused,
        least_clearance_m=float(np.nanmin(clearance_m)),
    )
