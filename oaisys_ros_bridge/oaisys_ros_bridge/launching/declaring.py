"""Arguments of launch files as ROS's launch system knows them."""

from __future__ import annotations

from collections.abc import Mapping

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration

from launch import LaunchContext
from oaisys_ros_bridge.launching.arguments import Argument
from oaisys_ros_bridge.parameters.node_settings import NodeSettings, node_settings


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
    """Return what an argument was given."""
    return str(LaunchConfiguration(name).perform(context))


def settings_of(context: LaunchContext) -> NodeSettings:
    """Return what was asked of all nodes.

    Raises:
        InvalidInputError: There is no such file, or it holds no parameters.
    """
    return node_settings(
        params_file=value_of(context, "params_file"),
        log_level=value_of(context, "log_level"),
        use_sim_time=value_of(context, "use_sim_time") == "true",
    )
