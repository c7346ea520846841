"""The paper's scene reconstruction: views from a grid above the terrain, a map, its evaluation.

The survey itself uses ROS as a planner would. What no planner could know comes from the simulator
over gRPC: the height of the ground to fly over, and the true surface to measure against.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from oaisys_core.errors import OaisysError
from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_down, pose_to_matrix
from oaisys_core.types import DEPTH, Pose, SensorInfo
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_mapping.certificate.perturbations import PosedDepth
from oaisys_mapping.evaluation.thresholds import survey_thresholds
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.rectification import rectified_camera
from oaisys_ros_bridge.experiments.bringup import MAP_TIMEOUT_S, SimulatorStack, bring_up
from oaisys_ros_bridge.experiments.evaluation.map_evaluation import (
    MESH_FILE,
    VOLUME_FILE,
    evaluate_and_certify,
)
from oaisys_ros_bridge.experiments.interruption import raise_if_interrupted
from oaisys_ros_bridge.experiments.planner_client import PlannerClient, ReceivedView
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.report import ExperimentRun, write_experiment_report
from oaisys_ros_bridge.experiments.survey.plan import (
    NORTH_UP_YAW_RAD,
    SurveyOptions,
    SurveyPlan,
    plan_survey,
    survey_columns,
)

VIEW_TIMEOUT_S = 300.0
MAP_FRAME = "map"


def run_survey(options: SurveyOptions, reporter: Reporter) -> bool:
    """Run a survey, write its report, and return whether the map agrees with the true surface.

    Raises:
        ConfigError: The configuration cannot be used.
        OaisysError: A process failed, or did not answer in time.
    """
    started_s = time.monotonic()
    with bring_up(options, PlannerClient, reporter) as stack:
        poses = _viewpoints(_plan(options, stack), stack.simulator)
        received = _render_all(stack, poses, reporter)
        losses = stack.client.shortfalls(MAP_TIMEOUT_S)
        reporter.say("saving the map")
        for name in (MESH_FILE, VOLUME_FILE):
            stack.client.save_mesh(str((options.out / name).resolve()), MAP_TIMEOUT_S)
        truth = stack.simulator.ground_truth_mesh()
        info = stack.simulator.info()
    views = _views(stack.sensor, poses)
    result = evaluate_and_certify(
        options,
        info,
        truth,
        views,
        _frames(stack.sensor, views, received) if options.faults else [],
        survey_thresholds(options.voxel_size_m),
        reporter,
    )
    return write_experiment_report(
        options,
        ExperimentRun(info, received, losses),
        result,
        reporter,
        title="Survey of a rendered terrain",
        columns=survey_columns(options.views),
        facts={"altitude_m": options.altitude_m, "overlap": options.overlap},
        seconds_total=time.monotonic() - started_s,
    )


def _plan(options: SurveyOptions, stack: SimulatorStack[PlannerClient]) -> SurveyPlan:
    extent_m = stack.simulator.info().stage_extent_m
    if extent_m is None:
        raise OaisysError("the simulator has lost its world since the bridge was ready")
    camera = stack.sensor.intrinsics
    return plan_survey(options.views, options.altitude_m, options.overlap, camera, extent_m)


def _render_all(
    stack: SimulatorStack[PlannerClient], poses: Sequence[Pose], reporter: Reporter
) -> list[ReceivedView]:
    """Return the views from all poses, once the map holds them."""
    received = []
    for pose in reporter.track(poses, "views"):
        raise_if_interrupted()
        view = stack.client.view(pose, stack.posed_sensor, MAP_FRAME, VIEW_TIMEOUT_S)
        received.append(view)
        reporter.step(f"rendered in {view.render_s:.2f} s, answered in {view.service_s:.2f} s")
    integration_s = stack.client.status.wait_for_map(len(poses), MAP_TIMEOUT_S)
    return [
        replace(
            view, integration_s=seconds, transfer_s=stack.client.status.transfer_s(view.stamp_ns)
        )
        for view, seconds in zip(received, integration_s, strict=True)
    ]


def _viewpoints(plan: SurveyPlan, simulator: SimulatorClient) -> list[Pose]:
    """Return poses that look down, each ``altitude_m`` above the surface below it."""
    xy_m = plan.xy_m
    points_m = np.column_stack((xy_m, np.zeros(len(xy_m))))
    surface_m = simulator.query_height(points_m).surface_height_m
    return [
        pose_looking_down(float(x), float(y), float(z) + plan.altitude_m, NORTH_UP_YAW_RAD)
        for (x, y), z in zip(xy_m, surface_m, strict=True)
    ]


def _views(sensor: SensorInfo, poses: Sequence[Pose]) -> list[PosedCamera]:
    """Return the rectified cameras, as the mapper fuses them, from poses of the sensor's link."""
    camera = rectified_camera(sensor.intrinsics)
    return [PosedCamera(camera, pose_to_matrix(pose) @ T_LINK_OPTICAL) for pose in poses]


def _frames(
    sensor: SensorInfo, views: Sequence[PosedCamera], received: Sequence[ReceivedView]
) -> list[PosedDepth]:
    """Return the received depth images, each with its camera and pose."""
    return [
        PosedDepth(images[DEPTH], sensor.intrinsics, view.T_map_camera)
        for view, images in zip(views, (one.images for one in received), strict=True)
        if DEPTH in images
    ]
