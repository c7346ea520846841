"""What the launch files share: their arguments, the end of a launch, and RViz."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from pathlib import Path

import launch.logging
from launch.action import Action
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext
from oaisys_core.system.ending.owner import command_with_owner
from oaisys_ros_bridge.launching.arguments import Argument
from oaisys_ros_bridge.namespaces import TF, TF_STATIC
from oaisys_ros_bridge.parameters.node_settings import NodeSettings, node_settings

RVIZ_TOPIC = "Value: /"
RVIZ_FIXED_FRAME = "Fixed Frame: map"


def declare(arguments: Mapping[str, Argument]) -> list[DeclareLaunchArgument]:
    """Return the declarations of arguments by name."""
    return [
        DeclareLaunchArgument(
            name,
            default_value=argument.default,
            description=argument.description,
            choices=list(argument.choices) or None,
        )
        for name, argument in arguments.items()
    ]


def value_of(context: LaunchContext, name: str) -> str:
    """Return the value of an argument."""
    return str(LaunchConfiguration(name).perform(context))


def settings_of(context: LaunchContext) -> NodeSettings:
    """Return the settings of all nodes.

    Raises:
        InvalidInputError: The parameter file does not exist or holds no parameters.
    """
    return node_settings(
        params_file=value_of(context, "params_file"),
        log_level=value_of(context, "log_level"),
        use_sim_time=value_of(context, "use_sim_time") == "true",
    )


class ProgramFailedError(Exception):
    """Ends the launch with exit code 1; the launch system has no other way to say so."""


def end_all(reason: str) -> Callable[[ProcessExited, LaunchContext], list[Action]]:
    """Return an exit handler that ends the launch, unless it is ending already.

    The launch's exit code is 1 if the process's is not 0. The launch system would also exit with 1
    after a second `Shutdown`.
    """

    def end(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if context.is_shutdown:
            return []
        if event.returncode != 0:
            raise ProgramFailedError(f"{reason}: exit code {event.returncode}")
        return [Shutdown(reason=reason)]

    return end


def rviz(
    config: Path, namespace: str = "", frame_prefix: str = "", *, use_sim_time: bool = False
) -> Node:
    """Return RViz with the displays of a file.

    Args:
        config: For the root namespace; a changed copy is written to the launch's log folder.
        namespace: Of the simulator.
        frame_prefix: Of the simulator's frames, which are then on the common ``/tf``.
        use_sim_time: Whether it follows ``/clock``.
    """
    text = config.read_text(encoding="utf-8")
    changed = text
    if namespace:
        changed = changed.replace(RVIZ_TOPIC, f"{RVIZ_TOPIC}{namespace.strip('/')}/")
    changed = changed.replace(RVIZ_FIXED_FRAME, f"Fixed Frame: {frame_prefix}map")
    file = config
    if changed != text:
        file = Path(launch.logging.launch_config.log_dir, config.name)
        file.write_text(changed, encoding="utf-8")
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        arguments=["-d", str(file)],
        prefix=[
            shlex.join(command_with_owner([])),
            " ",
            LaunchConfiguration("launch-prefix", default=""),
        ],
        parameters=[{"use_sim_time": use_sim_time}],
        remappings=tf_remappings(namespace, frame_prefix),
    )


def tf_remappings(namespace: str, frame_prefix: str) -> list[tuple[str, str]]:
    """Return the rules that move TF into a namespace; none where frames have a prefix instead."""
    if not namespace or frame_prefix:
        return []
    return [(topic, topic.removeprefix("/")) for topic in (TF, TF_STATIC)]
