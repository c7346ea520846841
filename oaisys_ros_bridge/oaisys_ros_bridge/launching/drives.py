"""The actions of ``drive.launch.py``: the simulator, and a drive that ends the launch."""

from __future__ import annotations

from pathlib import Path

from launch.action import Action
from launch.actions import ExecuteProcess

from launch import LaunchContext
from oaisys_core.system.ending.owner import owner_variables
from oaisys_core.system.python_programs import python_command
from oaisys_ros_bridge.launching.actions import end_all, value_of
from oaisys_ros_bridge.launching.readiness import on_ready
from oaisys_ros_bridge.launching.simulator import start_simulator, uses_rosbag2
from oaisys_ros_bridge.namespaces import namespace_arguments

DEFAULT_CONFIG = "examples/rover_drive.yaml"


def start_drive(context: LaunchContext, config_folder: Path) -> list[Action]:
    """Return the simulator with its nodes, and a handler that starts the drive once they are ready.

    The bridge is the clock, so that all stamps are simulated time.

    Args:
        context: With the values of `DRIVE`.
        config_folder: The folder of `DEFAULT_CONFIG`.

    Raises:
        InvalidInputError: The namespace or the settings of the nodes are wrong.
    """
    actions = start_simulator(context, config_folder, DEFAULT_CONFIG, publishes_clock=True)
    namespace = value_of(context, "namespace")
    return [on_ready([_drive(context, namespace)], namespace), *actions]


def _drive(context: LaunchContext, namespace: str) -> ExecuteProcess:
    """Return the program that asks for the drive, with whose exit code the launch ends."""
    command = python_command("oaisys_ros_bridge.nodes.drive")
    if drive_json := value_of(context, "drive_json"):
        command += ["--drive-json", drive_json]
    if sensors := value_of(context, "sensors"):
        command += ["--sensors", *sensors.split(",")]
    is_recorded = value_of(context, "record") not in {"", "false"}
    if is_recorded and not uses_rosbag2(value_of(context, "recorder")):
        command.append("--wait-for-recorder")
    has_own_tf = not value_of(context, "frame_prefix")
    return ExecuteProcess(
        cmd=[*command, *namespace_arguments(namespace, has_own_tf=has_own_tf)],
        name="drive",
        output="screen",
        additional_env=owner_variables(),
        on_exit=end_all("the drive has ended"),
    )
