"""Server, bridge, mapper and recorder as child processes of an experiment, and talk with them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from oaisys_core.errors import ConfigError, DeadlineExceededError, OaisysError
from oaisys_core.geometry import T_LINK_OPTICAL
from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0, SensorInfo, SimulatorInfo
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_ros_bridge.experiments.domains import own_domain
from oaisys_ros_bridge.experiments.processes import ManagedProcess
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.survey_client import SurveyClient
from oaisys_ros_bridge.namespaces import TF, TF_STATIC, placing_arguments, require_namespace
from oaisys_ros_bridge.parameters.node_settings import NodeSettings
from oaisys_ros_bridge.publishing.sensor_topics import TOPIC_BY_MODALITY, sensor_namespace

START_TIMEOUT_S = 600.0
"""Until a world must stand: textures are made on a machine's first run."""

MAP_TIMEOUT_S = 120.0

CONFIG_FILE = "config.yaml"
"""The whole configuration of an experiment, in its folder."""

_ALARMING = re.compile(r"\b(WARN|WARNING|ERROR|CRITICAL|FATAL)\b|Traceback")
_LOOK_S = 0.5
_LINES_QUOTED = 3
"""Of each log, beside an error."""

Client = TypeVar("Client", bound=SurveyClient)


@dataclass(frozen=True)
class SystemOptions:
    """What runs in an experiment.

    Attributes:
        out: Folder for everything it writes.
        config: Configuration file; None: the default world.
        overrides: Options of ``oaisys config show`` that change the configuration.
        voxel_size_m, max_range_m: Of the map.
        record: Whether all is recorded as a bag.
        worker_python: Interpreter that has ``bpy``; None: this one.
        command: How it was called.
        namespace: In which all ROS nodes are; TF is below it, too. Empty: in none.
        server_options: Further ones of ``oaisys serve``.
        bridge_parameters: Further ones of the bridge.
        nodes: What is asked of all nodes.
    """

    out: Path
    config: Path | None
    overrides: Mapping[str, str]
    voxel_size_m: float
    max_range_m: float
    record: bool
    worker_python: Path | None
    command: Sequence[str]
    namespace: str = field(default="", kw_only=True)
    server_options: Sequence[str] = field(default=(), kw_only=True)
    bridge_parameters: Mapping[str, Any] = field(default_factory=dict, kw_only=True)
    nodes: NodeSettings = field(default=NodeSettings(), kw_only=True)


@dataclass(frozen=True)
class System(Generic[Client]):
    """The running processes, as an experiment talks to them.

    Attributes:
        posed_sensor: Whose pose is asked for; empty where the rig's is the sensor's own.
    """

    simulator: SimulatorClient
    client: Client
    sensor: SensorInfo
    posed_sensor: str


@contextmanager
def running_system(
    options: SystemOptions,
    make_client: Callable[[str, tuple[str, ...], str], Client],
    reporter: Reporter,
) -> Iterator[System[Client]]:
    """Start server, bridge, mapper and recorder; end them all, last started first.

    Args:
        options: What to run; its configuration is written to ``out`` whole and checked.
        make_client: Given the camera's namespace, the modalities to wait for, and the nodes'
            namespace.
        reporter: Told what is being started.

    Raises:
        ConfigError: The configuration cannot be used.
        OaisysError: A process failed, or did not answer in time.
    """
    require_namespace(options.namespace)
    config_path = write_config(options)
    logs = options.out / "logs"
    with ExitStack() as stack:
        stack.enter_context(naming_logs(logs))
        stack.enter_context(own_domain())
        environment = _environment()

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
        placed = placing_arguments(options.namespace)
        parameters = {"address": address, **options.bridge_parameters}
        bridge = start("bridge", *_node_arguments(options, "bridge", {}, parameters), *placed)
        namespace = sensor_namespace(sensor.name, info.sensors)
        usual, fixed = _mapper_parameters(options, namespace, sensor)
        mapper = start("mapper", *_node_arguments(options, "mapper", usual, fixed), *placed)
        modalities = tuple(m for m in (RGB, DEPTH, SEMANTIC_0, INSTANCE) if m in sensor.modalities)
        client = make_client(namespace, modalities, options.namespace)
        stack.enter_context(client)

        def wait_for_world() -> None:
            check_all = partial(_check_all, server, bridge, mapper)
            _wait_for_world(client, simulator, check_all, address)

        wait_for_world()
        client.wait_for_mapper()
        if options.record:
            bag = options.out / "bag"
            _remove_old_bag(bag)
            recording = _recorder_arguments(options, bag, namespace, modalities)
            recorder = start("recorder", *recording, *placed)
            recorder.wait_for_line("recording:", MAP_TIMEOUT_S)
        client.wait_for_subscribers()
        wait_for_world()  # a worker may have been lost since
        yield System(simulator, client, sensor, _posed_sensor(info))


def _wait_for_world(
    client: SurveyClient, simulator: SimulatorClient, check: Callable[[], None], address: str
) -> None:
    """Wait until the bridge is ready and the simulator, which is asked itself, has a world.

    Raises:
        OaisysError: A process ended, the world cannot be built, or it took too long.
    """
    end_s = time.monotonic() + START_TIMEOUT_S
    while True:
        client.wait_for_bridge(max(0.0, end_s - time.monotonic()), check, address)
        if simulator.info().stage_extent_m is not None:
            return
        if time.monotonic() >= end_s:
            raise DeadlineExceededError(
                f"the simulator at {address} had no world after {START_TIMEOUT_S:g} s"
            )
        time.sleep(_LOOK_S)


@contextmanager
def naming_logs(folder: Path) -> Iterator[None]:
    """Have an error that passes name the processes' logs, and what they warned of last."""
    began_s = time.time()
    try:
        yield
    except OaisysError as error:
        for log in sorted(folder.glob("*.log")):
            if log.stat().st_mtime < began_s - 1.0:
                continue  # of an earlier run
            error.add_note(f"log: {log}")
            lines = log.read_text(errors="replace").splitlines()
            found = [line for line in lines if _ALARMING.search(line)][-_LINES_QUOTED:]
            for line in found:
                error.add_note(f"  | {line}")
        raise


def _posed_sensor(info: SimulatorInfo) -> str:
    sensor = info.sensors[0]
    is_rig = len(info.sensors) == 1 and np.allclose(sensor.T_base_camera, T_LINK_OPTICAL)
    return "" if is_rig else sensor.name


def _check_all(*processes: ManagedProcess) -> None:
    for process in processes:
        process.check()


def write_config(options: SystemOptions) -> Path:
    """Write the whole configuration, checked, to the output folder and return its path."""
    command = [sys.executable, "-m", "oaisys_core", "config", "show"]
    if options.config is not None:
        command += ["--config", str(options.config)]
    for name, value in options.overrides.items():
        command += [f"--{name}", value]
    result = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=START_TIMEOUT_S
    )
    if result.returncode != 0:
        fault = result.stderr.strip().removeprefix("oaisys: ")
        raise ConfigError(fault) if result.returncode == 2 else OaisysError(fault)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / CONFIG_FILE
    path.write_text(result.stdout, encoding="utf-8")
    return path


def _environment() -> dict[str, str]:
    """Return the children's environment: discovery stays on this machine unless told otherwise."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return dict(os.environ)


def _server_arguments(options: SystemOptions, config_path: Path) -> list[str]:
    arguments = ["oaisys_grpc", "serve", "--config", str(config_path), "--address", "127.0.0.1:0"]
    if options.worker_python is not None:
        arguments += ["--worker-python", str(options.worker_python)]
    return [*arguments, *options.server_options]


def _node_arguments(
    options: SystemOptions, node: str, usual: Mapping[str, Any], fixed: Mapping[str, Any]
) -> list[str]:
    return [f"oaisys_ros_bridge.nodes.{node}", *options.nodes.ros_arguments(node, usual, fixed)]


def _mapper_parameters(
    options: SystemOptions, namespace: str, sensor: SensorInfo
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what a file of parameters may change, and what not."""
    # The mesh is wanted once, at the end, and not every few seconds on the way.
    usual = {"mesh_period": 0.0, "use_semantics": SEMANTIC_0 in sensor.modalities}
    fixed = {
        "camera": namespace,
        "voxel_size": options.voxel_size_m,
        "max_range": options.max_range_m,
    }
    return usual, fixed


def _remove_old_bag(folder: Path) -> None:
    """Make room for a new bag, but only where an earlier survey's is."""
    if any(folder.glob("*.mcap")):
        shutil.rmtree(folder)


def _recorder_arguments(
    options: SystemOptions, folder: Path, namespace: str, modalities: Sequence[str]
) -> list[str]:
    """Return what records everything, and begins once the sample's own topics are heard."""
    images = [f"{namespace}/{TOPIC_BY_MODALITY.get(m, m)}" for m in modalities]
    topics = [f"{image}/image_raw" for image in images]
    topics += [TF, TF_STATIC, "ground_truth/odometry", "oaisys_bridge/sample_info"]
    command = ["oaisys_ros_bridge.nodes.recorder", "--out", str(folder), "--all"]
    return [*command, "--topics", *topics, *options.nodes.ros_arguments("recorder", {}, {})]
