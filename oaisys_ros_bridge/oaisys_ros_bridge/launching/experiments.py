"""``oaisys survey`` and ``oaisys explore`` as launch files: the command, and RViz on request."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from launch.action import Action
from launch.actions import ExecuteProcess, OpaqueFunction

from launch import LaunchContext, LaunchDescription
from oaisys_core.system.ending.owner import owner_variables
from oaisys_core.system.python_programs import python_command
from oaisys_ros_bridge.launching.actions import declare, end_all, rviz, value_of
from oaisys_ros_bridge.launching.arguments import RVIZ, Argument, command_line, ros_environment
from oaisys_ros_bridge.launching.readiness import WatchReadiness, on_ready

END_TIMEOUT_S = "30"
"""From Ctrl-C to SIGTERM: an experiment ends its children one after the other."""


def experiment(
    command: str, options: Mapping[str, Argument], config_folder: Path
) -> LaunchDescription:
    """Return the launch of an experiment.

    Args:
        command: Of ``oaisys``.
        options: Arguments that are options of the command.
        config_folder: The folder of ``simulator.rviz``.
    """

    def start(context: LaunchContext) -> list[Action]:
        return _start(context, command, options, config_folder)

    declared = declare({**options, "rviz": RVIZ})
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def _start(
    context: LaunchContext, command: str, options: Mapping[str, Argument], config_folder: Path
) -> list[Action]:
    values = {name: value_of(context, name) for name in options}
    namespace = values["namespace"]
    actions: list[Action] = []
    if value_of(context, "rviz") == "true":
        view = rviz(config_folder / "simulator.rviz", namespace)
        actions += [on_ready([view], namespace), WatchReadiness(namespace)]
    program = ExecuteProcess(
        cmd=python_command("oaisys_core", command, *command_line(options, values)),
        name=command,
        output="screen",
        additional_env=ros_environment() | owner_variables(),
        sigterm_timeout=END_TIMEOUT_S,
        on_exit=end_all(f"{command} has ended"),
    )
    return [*actions, program]
