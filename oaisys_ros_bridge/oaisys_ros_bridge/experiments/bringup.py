"""Brings up server, bridge, mapper and recorder as the child processes of an experiment."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from oaisys_core.errors import DeadlineExceededError, OaisysError, RenderError
from oaisys_core.files.folders import own_folder
from oaisys_core.geometry import T_LINK_OPTICAL
from oaisys_core.system.ending.signals import defer_signals
from oaisys_core.system.owned_folders import OwnedFolder, remove_abandoned
from oaisys_core.system.processes import ManagedProcess
from oaisys_core.system.program_output import last_lines
from oaisys_core.system.python_programs import python_command
from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0, SensorInfo, SimulatorInfo
from oaisys_ros_bridge.experiments.configuration import (
    ConfiguredSensors,
    ExperimentOptions,
    read_sensors,
    write_config,
)
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.namespaces import (
    TF,
    TF_STATIC,
    namespace_arguments,
    own_domain,
    require_namespace,
)

if TYPE_CHECKING:  # they import ROS and gRPC, which takes longer than starting the processes
    from oaisys_grpc.client.simulator_client import SimulatorClient
    from oaisys_ros_bridge.experiments.planner_client import PlannerClient

START_TIMEOUT_S = 600.0
"""Until a world must be built; textures are made on a machine's first run."""

MAP_TIMEOUT_S = 120.0

_WARNING = re.compile(r"\b(WARN|WARNING|ERROR|CRITICAL|FATAL)\b|Traceback|Fatal Python error")
_POLL_PERIOD_S = 0.5
SOCKET_PREFIX = "oaisys-run-"
"""Of the folder of a simulator's socket."""
_LONGEST_FOLDER = 80
"""Characters of a folder for a socket, whose path has at most 107."""
_LINES_QUOTED = 3
"""Of each log, in the notes of an error."""

Client = TypeVar("Client", bound="PlannerClient")


@dataclass(frozen=True)
class SimulatorStack(Generic[Client]):
    """The running processes, as an experiment talks to them.

    Attributes:
        simulator: The gRPC client, for what no planner could know.
        client: The ROS client.
        sensor: The camera whose images are mapped.
        posed_sensor: The sensor whose pose is requested; empty where the rig's pose is the same.
    """

    simulator: SimulatorClient
    client: Client
    sensor: SensorInfo
    posed_sensor: str


@contextmanager
def bring_up(
    options: ExperimentOptions,
    make_client: Callable[[str, tuple[str, ...], str], Client],
    reporter: Reporter,
    other_seeds: Sequence[int] = (),
) -> Iterator[SimulatorStack[Client]]:
    """Start server, bridge, mapper and recorder; end the recorder and then the others.

    They start side by side; what this process needs itself is imported meanwhile.

    Args:
        options: What to run; the complete configuration is written to ``out``.
        make_client: Given the camera's namespace, the modalities to wait for, and the nodes'
            namespace.
        reporter: Says what is being started.
        other_seeds: Whose worlds are tried where the configuration's first one cannot be built.

    Raises:
        ConfigError: The configuration cannot be used.
        OaisysError: A process failed, or did not answer in time.
    """
    require_namespace(options.namespace)
    with ExitStack() as stack:
        stack.enter_context(own_folder(options.out))
        config_path = write_config(options)
        sensors = read_sensors(config_path)
        wanted = tuple(m for m in (RGB, DEPTH, SEMANTIC_0, INSTANCE) if m in sensors.modalities)
        stack.enter_context(naming_logs(options.out / "logs"))
        stack.enter_context(own_domain())
        address = f"unix:{stack.enter_context(socket_folder()).path}/server"
        processes = _Processes(options, stack)
        reporter.say("starting the simulator")
        server = processes.start_server(config_path, address)
        processes.start_bridge(address)
        namespace = _topic_prefix(sensors)
        processes.start_mapper(namespace, use_semantics=SEMANTIC_0 in wanted)
        # The recorder ends first, while the bridge can still resend what it lacks.
        stack.callback(processes.interrupt)
        recorder = processes.start_recorder(namespace, wanted) if options.record else None
        client = make_client(namespace, wanted, options.namespace)
        stack.enter_context(client)
        server.wait_for_line("ready:", START_TIMEOUT_S)
        reporter.say("building the world")
        simulator = stack.enter_context(_simulator_client(address))
        wait_for_world = partial(_wait_for_world, client, simulator, processes.check, address)
        _wait_for_any_world(wait_for_world, simulator, other_seeds, reporter)
        client.wait_for_mapper()
        if recorder is not None:
            recorder.wait_for_line("recording:", MAP_TIMEOUT_S)
        client.status.wait_for_subscribers()
        wait_for_world()  # a worker may have been lost since
        info = simulator.info()
        yield SimulatorStack(simulator, client, info.sensors[0], _sensor_with_pose(info))


def serve_arguments(options: ExperimentOptions, config_path: Path, address: str) -> list[str]:
    """Return the arguments of ``python -m oaisys_grpc`` with which a simulator serves."""
    arguments = ["serve", "--config", str(config_path), "--address", address]
    if options.worker_python is not None:
        arguments += ["--worker-python", str(options.worker_python)]
    return [*arguments, *options.server_options]


def socket_folder() -> OwnedFolder:
    """Return a folder for a socket, whose address is known before the server runs."""
    usual = tempfile.gettempdir()
    short = Path(usual if len(usual) <= _LONGEST_FOLDER else "/tmp")  # noqa: S108 - this user's
    remove_abandoned(SOCKET_PREFIX, short)
    return OwnedFolder(SOCKET_PREFIX, short)


def _topic_prefix(sensors: ConfiguredSensors) -> str:
    from oaisys_ros_bridge.topic_names import sensor_namespace

    return sensor_namespace(sensors.names[0], sensors.names)


def _simulator_client(address: str) -> SimulatorClient:
    from oaisys_grpc.client.simulator_client import SimulatorClient

    return SimulatorClient(address, timeout_s=START_TIMEOUT_S)


class _Processes:
    """Starts the processes of an experiment; ``stack`` ends them."""

    def __init__(self, options: ExperimentOptions, stack: ExitStack) -> None:
        self._options = options
        self._stack = stack
        self._running: list[ManagedProcess] = []
        # Nodes discover each other on this machine alone, unless the user has set otherwise.
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self._environment = dict(os.environ)

    def check(self) -> None:
        """Raise `WorkerLostError` where a process has ended."""
        for process in self._running:
            process.check()

    def interrupt(self) -> None:
        """Ask all processes to end, so that each ends while the others are waited for."""
        for process in self._running:
            process.interrupt()

    def start_server(self, config_path: Path, address: str) -> ManagedProcess:
        """Start the simulator; it prints ``ready:`` once its worker is ready."""
        return self._start(
            "server", "oaisys_grpc", serve_arguments(self._options, config_path, address)
        )

    def start_bridge(self, address: str) -> None:
        """Start the bridge; it looks for the server until that is ready."""
        fixed = {"address": address, **self._options.bridge_parameters}
        self._start_node("bridge", fixed=fixed)

    def start_mapper(self, namespace: str, *, use_semantics: bool) -> None:
        """Start the mapper of a camera; a parameter file may change ``usual``, not ``fixed``."""
        # No mesh and no map of the ground every few seconds: a mesh is saved at the end.
        usual = {"mesh_period": 0.0, "use_semantics": use_semantics}
        usual["ground_map.length_m"] = 0.0
        fixed = {
            "camera": namespace,
            "voxel_size": self._options.voxel_size_m,
            "max_range": self._options.max_range_m,
        }
        self._start_node("mapper", usual=usual, fixed=fixed)

    def start_recorder(self, namespace: str, modalities: Sequence[str]) -> ManagedProcess:
        """Record everything; it prints ``recording:`` once it hears the topics of a sample."""
        from oaisys_ros_bridge.topic_names import TOPIC_BY_MODALITY

        folder = self._options.out / "bag"
        _remove_old_bag(folder)
        topics = [f"{namespace}/{TOPIC_BY_MODALITY.get(m, m)}/image_raw" for m in modalities]
        topics += [TF, TF_STATIC, "ground_truth/odometry", "oaisys_bridge/sample_info"]
        arguments = ["--out", str(folder), "--all", "--topics", *topics]
        return self._start_node("recorder", arguments)

    def _start_node(
        self,
        name: str,
        arguments: Sequence[str] = (),
        usual: Mapping[str, Any] | None = None,
        fixed: Mapping[str, Any] | None = None,
    ) -> ManagedProcess:
        ros_arguments = self._options.nodes.ros_arguments(name, usual or {}, fixed or {})
        ros_arguments += namespace_arguments(self._options.namespace)
        return self._start(name, f"oaisys_ros_bridge.nodes.{name}", [*arguments, *ros_arguments])

    def _start(self, name: str, module: str, arguments: Sequence[str]) -> ManagedProcess:
        command = python_command(module, *arguments)
        log = self._options.out / "logs" / f"{name}.log"
        # A process that was started must be on the stack, or nothing would end it.
        with defer_signals():
            process = ManagedProcess(name, command, log, self._environment)
            self._stack.enter_context(process)
        self._running.append(process)
        return process


def _wait_for_world(
    client: PlannerClient, simulator: SimulatorClient, check: Callable[[], None], address: str
) -> None:
    """Wait until the bridge is ready and the simulator itself says that it has a world.

    Raises:
        OaisysError: A process ended, the world cannot be built, or it took too long.
    """
    end_s = time.monotonic() + START_TIMEOUT_S
    while True:
        try:
            client.status.wait_for_bridge(max(0.0, end_s - time.monotonic()), check, address)
        except RenderError:
            # Where there is a world, the bridge still tells of an earlier one.
            if simulator.info().stage_extent_m is None:
                raise
            time.sleep(_POLL_PERIOD_S)
            continue
        if simulator.info().stage_extent_m is not None:
            return
        if time.monotonic() >= end_s:
            raise DeadlineExceededError(
                f"the simulator at {address} had no world after {START_TIMEOUT_S:g} s"
            )
        time.sleep(_POLL_PERIOD_S)


def _wait_for_any_world(
    wait: Callable[[], None], simulator: SimulatorClient, seeds: Sequence[int], reporter: Reporter
) -> None:
    """Wait for the first world; where it cannot be built, have one of other seeds built."""
    for seed in seeds:
        try:
            wait()
        except RenderError as error:
            reporter.say(f"no world to begin with, trying seed {seed}: {error}")
        else:
            return
        with suppress(RenderError):
            simulator.step_batch(seed=seed)
    wait()


@contextmanager
def naming_logs(folder: Path) -> Iterator[None]:
    """Add the processes' logs, and the last warnings in them, to the notes of an error."""
    began_s = time.time()
    try:
        yield
    except OaisysError as error:
        for log in sorted(folder.glob("*.log")):
            if log.stat().st_mtime < began_s - 1.0:
                continue  # of an earlier run
            error.add_note(f"log: {log}")
            warnings = [line for line in last_lines(log) if _WARNING.search(line)]
            for line in warnings[-_LINES_QUOTED:]:
                error.add_note(f"  | {line}")
        raise


def _sensor_with_pose(info: SimulatorInfo) -> str:
    sensor = info.sensors[0]
    is_rig = len(info.sensors) == 1 and np.allclose(sensor.T_base_camera, T_LINK_OPTICAL)
    return "" if is_rig else sensor.name


def _remove_old_bag(folder: Path) -> None:
    """Remove the bag of an earlier experiment, but no other folder."""
    if any(folder.glob("*.mcap")):
        shutil.rmtree(folder)
