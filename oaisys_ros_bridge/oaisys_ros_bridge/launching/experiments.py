"""``oaisys survey`` and ``oaisys explore`` as launch files: the command, and RViz on request."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from launch.action import Action
from launch.actions import ExecuteProcess, OpaqueFunction

from launch import LaunchContext, LaunchDescription
from oaisys_ros_bridge.launching.arguments import (
    BACKEND,
    CONFIG,
    NAMESPACE,
    RVIZ,
    SWITCH,
    WORKER_PYTHON,
    Argument,
    declare,
    ros_environment,
    value_of,
)
from oaisys_ros_bridge.launching.ending import end_all
from oaisys_ros_bridge.launching.readiness import WatchReadiness, on_ready
from oaisys_ros_bridge.launching.views import rviz

END_TIMEOUT_S = "30"
"""How long it may take to end after Ctrl-C: it ends its own children, one after the other."""

RECORD = Argument("true", "Whether everything is recorded as a rosbag2 MCAP.", SWITCH)
SHARED = {
    "config": CONFIG,
    "backend": BACKEND,
    "seed": Argument("", "Root seed of the world; empty: as configured."),
    "size": Argument("", "WIDTHxHEIGHT of the images, for a quick look; empty: as configured."),
    "quality": Argument("", "Of colour, preview to final; empty: as configured."),
    "namespace": NAMESPACE,
    "worker_python": WORKER_PYTHON,
}
"""Arguments of every experiment, each an option of the command."""


def experiment(command: str, own: Mapping[str, Argument], config_folder: Path) -> LaunchDescription:
    """Return the launch of an experiment.

    Args:
        command: Of ``oaisys``.
        own: Arguments that are options of this command alone.
        config_folder: With ``simulator.rviz``.
    """
    options = {**own, **SHARED}

    def start(context: LaunchContext) -> list[Action]:
        return _start(context, command, options, config_folder)

    declared = declare({**options, "record": RECORD, "rviz": RVIZ})
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def _start(
    context: LaunchContext, command: str, options: Mapping[str, Argument], config_folder: Path
) -> list[Action]:
    line = [sys.executable, "-m", "oaisys_core", command]
    for name in options:
        if value := value_of(context, name):
            line += ["--" + name.replace("_", "-"), value]
    if value_of(context, "record") == "false":
        line.append("--no-bag")
    namespace = value_of(context, "namespace")
    actions: list[Action] = []
    if value_of(context, "rviz") == "true":
        view = rviz(config_folder / "simulator.rviz", namespace)
        actions += [on_ready([view], namespace), WatchReadiness(namespace)]
    program = ExecuteProcess(
        cmd=line,
        name=command,
        output="screen",
        additional_env=ros_environment(),
        sigterm_timeout=END_TIMEOUT_S,
        on_exit=end_all(f"{command} has ended"),
    )
    return [*actions, program]
