"""Arguments that several launch files have."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration

from launch import LaunchContext

SWITCH = ("true", "false")


@dataclass(frozen=True)
class Argument:
    """What can be said on the command line.

    Attributes:
        default: As text.
        description: One sentence.
        choices: All that it may be; none: anything.
    """

    default: str
    description: str
    choices: tuple[str, ...] = ()

    def declared(self, name: str) -> DeclareLaunchArgument:
        """Return it as the launch system knows it."""
        return DeclareLaunchArgument(
            name,
            default_value=self.default,
            description=self.description,
            choices=list(self.choices) or None,
        )


CONFIG = Argument("", "YAML file that describes the world and its cameras; empty: the usual one.")
BACKEND = Argument(
    "",
    "What renders; empty: as the configuration says.",
    ("", "blender", "analytic"),
)
WORKER_PYTHON = Argument(
    "", "Python interpreter that has bpy; empty: the one that runs the server."
)
NAMESPACE = Argument(
    "",
    "ROS namespace of all nodes and topics; /tf and /tf_static become NAMESPACE/tf and "
    "NAMESPACE/tf_static, so that simulators run side by side. /clock and /diagnostics stay.",
)
RVIZ = Argument("false", "Whether to open RViz with everything in view, once it is ready.", SWITCH)


def declare(arguments: Mapping[str, Argument]) -> list[DeclareLaunchArgument]:
    """Return the declarations of arguments by name."""
    return [argument.declared(name) for name, argument in arguments.items()]


def value_of(context: LaunchContext, name: str) -> str:
    """Return what an argument was given."""
    return str(LaunchConfiguration(name).perform(context))


def ros_environment() -> dict[str, str]:
    """Return the ROS domain of the launch, for programs that would take one of their own."""
    return {"ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "0")}
