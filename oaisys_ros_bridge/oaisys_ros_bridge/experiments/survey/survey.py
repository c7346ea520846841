"""The paper's scene reconstruction: views from a grid above the terrain, a map, its evaluation.

The survey itself uses ROS as a planner would. What no planner could know comes from the simulator
over gRPC: the height of the ground to fly over, and the true surface to measure against.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oaisys_core.errors import OaisysError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import RGB, Pose
from oaisys_ros_bridge.experiments.bringup import MAP_TIMEOUT_S, SimulatorStack, bring_up
from oaisys_ros_bridge.experiments.configuration import MESH_FILE, VOLUME_FILE
from oaisys_ros_bridge.experiments.interruption import raise_if_interrupted
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.survey.plan import (
    NORTH_UP_YAW_RAD,
    SurveyOptions,
    SurveyPlan,
    plan_survey,
)

if TYPE_CHECKING:  # they import ROS and gRPC, which `bring_up` does while the processes start
    from oaisys_grpc.client.simulator_client import SimulatorClient
    from oaisys_ros_bridge.experiments.planner_client import PlannerClient, ReceivedView

VIEW_TIMEOUT_S = 300.0
MAP_FRAME = "map"
FIRST_PICTURE_FILE = "first_picture.png"

EVALUATION = "oaisys_ros_bridge.experiments.survey.evaluation"
"""Imports Open3D, SciPy and Matplotlib: while the map is saved, because no view needs them."""


def run_survey(
    options: SurveyOptions, reporter: Reporter, elapsed_s: Callable[[], float] | None = None
) -> bool:
    """Run a survey, write its report, and return whether the map agrees with the true surface.

    Args:
        options: What is surveyed, and how.
        reporter: Says what is being done.
        elapsed_s: Returns the seconds since the start, from which the first picture and the report
            are timed; None: since the call.

    Raises:
        ConfigError: The configuration cannot be used.
        OaisysError: A process failed, or did not answer in time.
    """
    called_s = time.monotonic()
    elapsed_s = elapsed_s or (lambda: time.monotonic() - called_s)
    begun_s = elapsed_s()
    with bring_up(options, _planner_client, reporter) as stack:
        poses = _viewpoints(_plan(options, stack), stack.simulator)
        received: list[ReceivedView] = []
        first_picture_s: float | None = None
        for view in _render(stack, poses, reporter):
            received.append(view)
            if len(received) == 1:
                first_picture_s = _show(view, options.out, elapsed_s, reporter)
        received = _with_map_times(stack, received)
        losses = stack.client.shortfalls(MAP_TIMEOUT_S)
        reporter.say("saving the map")
        with ThreadPoolExecutor(1) as loader:
            loader.submit(import_module, EVALUATION)
            for name in (MESH_FILE, VOLUME_FILE):
                stack.client.save_mesh(str((options.out / name).resolve()), MAP_TIMEOUT_S)
        truth = stack.simulator.ground_truth_mesh()
        info = stack.simulator.info()
    from oaisys_ros_bridge.experiments.report import ExperimentRun
    from oaisys_ros_bridge.experiments.survey.evaluation import SurveyResult, report_survey

    run = ExperimentRun(info, received, losses)
    survey = SurveyResult(stack.sensor, poses, run, truth, begun_s, first_picture_s)
    return report_survey(options, survey, reporter, elapsed_s)


def _planner_client(
    namespace: str, modalities: tuple[str, ...], ros_namespace: str
) -> PlannerClient:
    from oaisys_ros_bridge.experiments.planner_client import PlannerClient

    return PlannerClient(namespace, modalities, ros_namespace)


def _plan(options: SurveyOptions, stack: SimulatorStack[PlannerClient]) -> SurveyPlan:
    info = stack.simulator.info()
    if options.light is not None:
        options.light.check_renderer(info)
    extent_m = info.stage_extent_m
    if extent_m is None:
        raise OaisysError("the simulator has lost its world since the bridge was ready")
    camera = stack.sensor.intrinsics
    return plan_survey(options.views, options.altitude_m, options.overlap, camera, extent_m)


def _render(
    stack: SimulatorStack[PlannerClient], poses: Sequence[Pose], reporter: Reporter
) -> Iterator[ReceivedView]:
    """Yield the views from all poses as they are received."""
    for pose in reporter.track(poses, "views"):
        raise_if_interrupted()
        view = stack.client.view(pose, stack.posed_sensor, MAP_FRAME, VIEW_TIMEOUT_S)
        reporter.step(f"rendered in {view.render_s:.2f} s, answered in {view.service_s:.2f} s")
        yield view


def _show(
    view: ReceivedView, out: Path, elapsed_s: Callable[[], float], reporter: Reporter
) -> float | None:
    """Write a view's colour image, say where it is, and return when; None: it has no colour.

    Raises:
        OaisysError: The file cannot be written.
    """
    import cv2

    if RGB not in view.images:
        return None
    path = out / FIRST_PICTURE_FILE
    if not cv2.imwrite(str(path), cv2.cvtColor(view.images[RGB], cv2.COLOR_RGB2BGR)):
        raise OaisysError(f"{path} cannot be written")
    seconds = elapsed_s()
    reporter.say(f"first picture after {seconds:.1f} s: {path}")
    return seconds


def _with_map_times(
    stack: SimulatorStack[PlannerClient], views: Sequence[ReceivedView]
) -> list[ReceivedView]:
    """Wait until the map holds the views; return them with the times of transfer and fusion."""
    status = stack.client.status
    integration_s = status.wait_for_map(len(views), MAP_TIMEOUT_S)
    return [
        replace(view, integration_s=seconds, transfer_s=status.transfer_s(view.stamp_ns))
        for view, seconds in zip(views, integration_s, strict=True)
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
