"""Where a vehicle flies in one world: what no planner could know, asked of the simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oaisys_core.errors import OaisysError
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.types import FloatArray, Pose, SensorInfo, TriangleMesh
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.exploration.coverage import SurfaceCoverage, random_poses
from oaisys_mapping.exploration.flight_box import flight_box
from oaisys_mapping.exploration.occupancy_map import Bounds
from oaisys_mapping.exploration.planner import Vehicle
from oaisys_mapping.rectification import rectify_camera
from oaisys_ros_bridge.experiments.explore.plan import ExploreOptions, start_pose

REACHABLE_POSES = 600
"""Random poses in truly free space: surface that none of them sees counts as out of reach."""

COVERAGE_SPACING_M = 0.4
"""A point of the true surface stands for a square of this edge length."""


@dataclass(frozen=True)
class FlightArea:
    """The part of one world that a vehicle flies in, and the true surface in it."""

    vehicle: Vehicle
    bounds: Bounds
    start: Pose
    truth: TriangleMesh
    coverage: SurfaceCoverage

    def camera(self, pose: Pose) -> PosedCamera:
        """Return the camera at a pose of the vehicle."""
        T_map_camera = pose_to_matrix(pose) @ self.vehicle.T_base_camera
        return PosedCamera(self.vehicle.intrinsics, T_map_camera)


def flight_area(
    options: ExploreOptions, simulator: SimulatorClient, sensor: SensorInfo, seed: int
) -> FlightArea:
    """Return the area of the simulator's world, which was made from ``seed``.

    Raises:
        InvalidInputError: The vehicle does not fit where it starts.
        OaisysError: The simulator did not answer, or has no world.
    """
    extent_m = simulator.info().stage_extent_m
    if extent_m is None:
        raise OaisysError("the simulator has no world")
    vehicle = Vehicle(
        rectify_camera(sensor.intrinsics),
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

    reachable = random_poses(bounds, vehicle, clearance_m, REACHABLE_POSES, rng)
    coverage = SurfaceCoverage(truth, vehicle, reachable, COVERAGE_SPACING_M, rng)
    return FlightArea(vehicle, bounds, start, truth, coverage)


def _heights_of(simulator: SimulatorClient) -> Callable[[FloatArray], FloatArray]:
    def height_m(xy_m: FloatArray) -> FloatArray:
        points_m = np.column_stack((xy_m, np.zeros(len(xy_m))))
        return simulator.query_height(points_m).surface_height_m

    return height_m
