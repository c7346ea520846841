"""The actions of ``simulator.launch.py``: server, then bridge, mapper and recorder."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.action import Action
from launch.actions import ExecuteProcess, LogInfo, RegisterEventHandler
from launch.event_handlers import OnProcessIO
from launch.events.process import ProcessIO
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchContext
from oaisys_core.system.ending.owner import command_with_owner, owner_variables
from oaisys_core.system.python_programs import python_command
from oaisys_ros_bridge.bags.rosbag2_command import rosbag2_command
from oaisys_ros_bridge.launching.actions import (
    end_all,
    rviz,
    settings_of,
    tf_remappings,
    value_of,
)
from oaisys_ros_bridge.launching.readiness import WatchReadiness, on_ready
from oaisys_ros_bridge.namespaces import OUTSIDE, TF, TF_STATIC, require_namespace
from oaisys_ros_bridge.parameters.node_settings import NodeSettings

PACKAGE = "oaisys_ros_bridge"
READY = b"ready: "
END_TIMEOUT_S = "12"
"""From Ctrl-C to SIGTERM: the recorder closes its bag in between."""

FRAMES = {"map": "map", "odom": "odom", "base": "base_link"}
"""Frames by the names of their parameters, without ``_frame``."""


def start_simulator(
    context: LaunchContext,
    config_folder: Path,
    default_config: str = "simulator.yaml",
    *,
    publishes_clock: bool = False,
) -> list[Action]:
    """Return the server, and handlers that start the nodes once it serves.

    Args:
        context: With the values of `SIMULATOR`.
        config_folder: The folder of ``default_config`` and ``simulator.rviz``.
        default_config: File of the world if the argument ``config`` is empty.
        publishes_clock: Whether the bridge is told to be the clock.

    Raises:
        InvalidInputError: The namespace or the settings of the nodes are wrong.
    """
    namespace = value_of(context, "namespace")
    require_namespace(namespace)
    settings_of(context)  # raises for wrong input before anything is started
    command = python_command("oaisys_grpc", "serve", "--config")
    command.append(value_of(context, "config") or str(config_folder / default_config))
    for name in ("address", "backend", "worker_python"):
        if value := value_of(context, name):
            command += ["--" + name.replace("_", "-"), value]
    server = ExecuteProcess(
        cmd=command,
        name="simulator",
        output="screen",
        additional_env=owner_variables(),
        sigterm_timeout=END_TIMEOUT_S,
        # Nothing works without it.
        on_exit=end_all("the simulator has ended"),
    )
    output = bytearray()
    started: list[Action] = []

    def follow(event: ProcessIO) -> list[Action]:
        """Start the nodes when the server prints its address."""
        output.extend(event.text)
        if started or READY not in output or b"\n" not in output.split(READY, 1)[1]:
            return []
        address = output.split(READY, 1)[1].split(b"\n")[0].decode().strip()
        started.extend(_nodes(context, address, publishes_clock=publishes_clock))
        output.clear()
        return started

    ready: list[Action] = [LogInfo(msg=f"ready: {namespace.strip('/') or 'simulator'}")]
    if value_of(context, "rviz") == "true":
        prefix = value_of(context, "frame_prefix")
        sim_time = value_of(context, "use_sim_time") == "true"
        config = config_folder / "simulator.rviz"
        ready.append(rviz(config, namespace, prefix, use_sim_time=sim_time))
    return [
        RegisterEventHandler(OnProcessIO(target_action=server, on_stdout=follow)),
        on_ready(ready, namespace),
        WatchReadiness(namespace),
        server,
    ]


def _nodes(context: LaunchContext, address: str, *, publishes_clock: bool) -> list[Action]:
    """Return bridge, mapper and recorder, which discover each other."""
    namespace = value_of(context, "namespace")
    prefix = value_of(context, "frame_prefix")
    remappings = tf_remappings(namespace, prefix)
    frames = {f"{name}_frame": f"{prefix}{frame}" for name, frame in FRAMES.items()}
    if not prefix:
        frames = {}
    settings = settings_of(context)

    def node(kind: type[Node], executable: str, fixed: dict[str, Any], **options: Any) -> Node:
        return kind(
            package=PACKAGE,
            executable=executable,
            name=f"oaisys_{executable}",
            namespace=namespace,
            parameters=_parameters(settings, executable, fixed),
            ros_arguments=["--log-level", settings.log_level] if settings.log_level else [],
            remappings=remappings,
            output="screen",
            additional_env=owner_variables(),
            sigterm_timeout=END_TIMEOUT_S,
            **options,
        )

    bridge = {"address": ParameterValue(address, value_type=str), **frames}
    if prefix:
        bridge["frame_prefix"] = prefix
    if publishes_clock:
        bridge["publish_clock"] = True
    end = end_all("the bridge has ended")
    actions: list[Action] = [node(LifecycleNode, "bridge", bridge, on_exit=end)]
    if value_of(context, "mapper") == "true":
        mapper = {name: frame for name, frame in frames.items() if name == "map_frame"}
        actions.append(node(Node, "mapper", mapper))
    record = value_of(context, "record")
    if record in {"", "false"}:
        return actions
    folder = "" if record == "true" else record
    if uses_rosbag2(value_of(context, "recorder")):
        return [*actions, _rosbag2(folder, namespace, has_own_tf=bool(remappings))]
    path = {"path": ParameterValue(folder, value_type=str)} if folder else {}
    return [*actions, node(Node, "recorder", path)]


def _parameters(settings: NodeSettings, executable: str, fixed: dict[str, Any]) -> list[Any]:
    """Return a node's parameters.

    Raises:
        InvalidInputError: The parameter file names one that the launch file sets.
    """
    settings.require_free(executable, fixed)
    file = [] if settings.params_file is None else [str(settings.params_file)]
    clock = {"use_sim_time": True} if settings.follows_clock(executable) else {}
    return [*file, {**fixed, **clock}] if fixed or clock else file


def uses_rosbag2(recorder: str) -> bool:
    """Return whether ``ros2 bag`` records; with ``auto``, where it is installed."""
    if recorder != "auto":
        return recorder == "ros2"
    try:
        return bool(get_package_prefix("ros2bag") and get_package_prefix("rosbag2_storage_mcap"))
    except PackageNotFoundError:
        return False


def _rosbag2(folder: str, namespace: str, *, has_own_tf: bool) -> ExecuteProcess:
    """Return ``ros2 bag record`` of the topics that this package's recorder would record."""
    folder = folder or time.strftime("bag_%Y_%m_%d-%H_%M_%S")
    shared = set(OUTSIDE) - {TF, TF_STATIC} if has_own_tf else OUTSIDE
    command = rosbag2_command(folder, namespace.strip("/"), shared)
    return ExecuteProcess(
        cmd=command_with_owner(command, signal.SIGINT),
        name="recorder",
        output="screen",
        sigterm_timeout=END_TIMEOUT_S,
    )
