"""The paper's scene reconstruction: look down from a grid, rebuild the terrain, measure it.

Server, bridge, mapper and recorder are processes of their own; the survey itself is a planner that
knows only ROS. The simulator's own interface is asked for what no planner could know: the height
of the ground, to fly over it, and the true surface, to measure against.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import ConfigError, OaisysError
from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_down, pose_to_matrix
from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0, Pose, SensorInfo, SimulatorInfo
from oaisys_grpc.client import SimulatorClient
from oaisys_mapping.certificate import write_views
from oaisys_mapping.mesh_io import read_ply, write_truth
from oaisys_mapping.metrics import evaluate_reconstruction
from oaisys_mapping.rectification import rectified_camera
from oaisys_mapping.report import write_report
from oaisys_mapping.visibility import View
from oaisys_ros_bridge.interruption import raise_if_interrupted
from oaisys_ros_bridge.processes import ManagedProcess
from oaisys_ros_bridge.progress import Reporter
from oaisys_ros_bridge.sample_publisher import TOPIC_BY_MODALITY, sensor_namespace
from oaisys_ros_bridge.survey_client import ReceivedView, SurveyClient
from oaisys_ros_bridge.survey_plan import NORTH_UP_YAW_RAD, SurveyOptions, SurveyPlan, plan_survey
from oaisys_ros_bridge.survey_report import say_result, survey_report

START_TIMEOUT_S = 600.0
"""Until a world must stand: textures are made on a machine's first run."""

VIEW_TIMEOUT_S = 300.0
MAP_TIMEOUT_S = 120.0
MAP_FRAME = "map"


def run_survey(options: SurveyOptions, reporter: Reporter) -> bool:
    """Run a survey, write its report, and return whether the loop closes.

    Raises:
        ConfigError: The configuration cannot be used.
        OaisysError: A process failed, or did not answer in time.
    """
    started_s = time.monotonic()
    options.out.mkdir(parents=True, exist_ok=True)
    config_path = _write_config(options)
    with ExitStack() as stack:
        system = stack.enter_context(_running_system(options, config_path, reporter))
        poses = _viewpoints(system.plan, system.simulator)
        received = _visit(system, poses, reporter)
        views = _views(system.sensor, poses)
        write_views(options.out / "poses.json", views)
        reporter.say("saving the mesh")
        mesh_path = options.out / "mesh.ply"
        system.client.save_mesh(str(mesh_path.resolve()), MAP_TIMEOUT_S)
        truth = system.simulator.ground_truth_mesh()
        info = system.simulator.info()
    reporter.say("measuring against the true surface")
    write_truth(options.out / "truth.ply", truth)
    mesh = read_ply(mesh_path)
    rng = np.random.default_rng(info.seed)
    evaluation = evaluate_reconstruction(
        mesh, truth, views, options.voxel_size_m, options.max_range_m, rng
    )
    report = survey_report(
        options, info, evaluation, mesh, received, time.monotonic() - started_s, config_path
    )
    write_report(report, options.out)
    say_result(report, options, reporter)
    return not report.missed


@dataclass(frozen=True)
class System:
    """The running processes, as the survey talks to them.

    Attributes:
        posed_sensor: Whose pose is asked for; empty where the rig's is the sensor's own.
    """

    simulator: SimulatorClient
    client: SurveyClient
    sensor: SensorInfo
    posed_sensor: str
    plan: SurveyPlan


@contextmanager
def _running_system(
    options: SurveyOptions, config_path: Path, reporter: Reporter
) -> Iterator[System]:
    """Start server, bridge, mapper and recorder; end them all, last started first."""
    logs = options.out / "logs"
    environment = _environment()
    with ExitStack() as stack:

        def start(name: str, *arguments: str) -> ManagedProcess:
            command = [sys.executable, "-m", *arguments]
            process = ManagedProcess(name, command, logs / f"{name}.log", environment)
            return stack.enter_context(process)

        reporter.say("starting the simulator")
        server = start("server", *_server_arguments(options, config_path))
        address = server.wait_for_line("ready:", START_TIMEOUT_S)
        simulator = stack.enter_context(SimulatorClient(address, timeout_s=START_TIMEOUT_S))
        info = simulator.info()
        sensor = info.sensors[0]
        reporter.say("building the world")
        bridge = start("bridge", *_node_arguments("bridge", {"address": address}))
        namespace = sensor_namespace(sensor.name, info.sensors)
        mapping = _mapper_parameters(options, namespace)
        mapper = start("mapper", *_node_arguments("mapper", mapping))
        modalities = tuple(m for m in (RGB, DEPTH, SEMANTIC_0, INSTANCE) if m in sensor.modalities)
        client = stack.enter_context(SurveyClient(namespace, modalities))
        client.wait_for_bridge(START_TIMEOUT_S, lambda: _check_all(server, bridge, mapper))
        client.wait_for_mapper()
        if options.record:
            bag = options.out / "bag"
            _remove_old_bag(bag)
            recorder = start("recorder", *_recorder_arguments(bag, namespace, modalities))
            recorder.wait_for_line("recording:", MAP_TIMEOUT_S)
        client.wait_for_subscribers()
        extent_m = simulator.info().stage_extent_m
        if extent_m is None:
            raise OaisysError("the bridge is ready, but the simulator has no world")
        plan = plan_survey(
            options.views, options.altitude_m, options.overlap, sensor.intrinsics, extent_m
        )
        yield System(simulator, client, sensor, _posed_sensor(info), plan)


def _posed_sensor(info: SimulatorInfo) -> str:
    sensor = info.sensors[0]
    is_rig = len(info.sensors) == 1 and np.allclose(sensor.T_base_camera, T_LINK_OPTICAL)
    return "" if is_rig else sensor.name


def _check_all(*processes: ManagedProcess) -> None:
    for process in processes:
        process.check()


def _visit(system: System, poses: Sequence[Pose], reporter: Reporter) -> list[ReceivedView]:
    """Look from every pose in turn."""
    received = []
    for pose in reporter.track(poses, "views"):
        raise_if_interrupted()
        view = system.client.view(pose, system.posed_sensor, MAP_FRAME, VIEW_TIMEOUT_S)
        received.append(view)
        reporter.step(f"rendered in {view.render_s:.2f} s, answered in {view.service_s:.2f} s")
    integration_s = system.client.wait_for_map(len(poses), MAP_TIMEOUT_S)
    return [
        replace(view, integration_s=seconds)
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


def _views(sensor: SensorInfo, poses: Sequence[Pose]) -> list[View]:
    """Return the cameras as the mapper rectifies them: a pose is that of the sensor's link."""
    camera = rectified_camera(sensor.intrinsics)
    return [View(camera, pose_to_matrix(pose) @ T_LINK_OPTICAL) for pose in poses]


def _write_config(options: SurveyOptions) -> Path:
    """Write the whole configuration, checked, to the output folder and return its path."""
    command = [sys.executable, "-m", "oaisys_core", "config", "show"]
    if options.config is not None:
        command += ["--config", str(options.config)]
    for name, value in options.overrides.items():
        command += [f"--{name}", value]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    if result.returncode != 0:
        fault = result.stderr.strip().removeprefix("oaisys: ")
        raise ConfigError(fault) if result.returncode == 2 else OaisysError(fault)
    path = options.out / "config.yaml"
    path.write_text(result.stdout, encoding="utf-8")
    return path


def _environment() -> dict[str, str]:
    """Return the children's environment, in a ROS domain of this survey's own unless one is set."""
    if "ROS_DOMAIN_ID" not in os.environ:
        os.environ["ROS_DOMAIN_ID"] = str(random.SystemRandom().randint(1, 101))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return dict(os.environ)


def _server_arguments(options: SurveyOptions, config_path: Path) -> list[str]:
    arguments = ["oaisys_grpc", "serve", "--config", str(config_path), "--address", "127.0.0.1:0"]
    if options.worker_python is not None:
        arguments += ["--worker-python", str(options.worker_python)]
    return arguments


def _node_arguments(node: str, parameters: Mapping[str, Any]) -> list[str]:
    arguments = [f"oaisys_ros_bridge.nodes.{node}", "--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={value}"]
    return arguments


def _mapper_parameters(options: SurveyOptions, namespace: str) -> dict[str, Any]:
    return {
        "camera": namespace,
        "voxel_size": options.voxel_size_m,
        "max_range": options.max_range_m,
        # The mesh is wanted once, at the end, and not every few seconds on the way.
        "mesh_period": 0.0,
    }


def _remove_old_bag(folder: Path) -> None:
    """Make room for a new bag, but only where an earlier survey's is."""
    if any(folder.glob("*.mcap")):
        shutil.rmtree(folder)


def _recorder_arguments(folder: Path, namespace: str, modalities: Sequence[str]) -> list[str]:
    """Return what records everything, and begins once the sample's own topics are heard."""
    images = [f"{namespace}/{TOPIC_BY_MODALITY.get(m, m)}" for m in modalities]
    topics = [f"{image}/image_raw" for image in images]
    topics += ["/tf", "/tf_static", "ground_truth/odometry", "oaisys_bridge/sample_info"]
    command = ["oaisys_ros_bridge.nodes.recorder", "--out", str(folder), "--all"]
    return [*command, "--topics", *topics]
