"""Simulator, bridge and mapper; a recorder and RViz on request."""

import sys
from pathlib import Path

from launch.action import Action
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchContext, LaunchDescription

PACKAGE = "oaisys_ros_bridge"
CONFIG = Path(__file__).resolve().parents[1] / "config"


def generate_launch_description() -> LaunchDescription:
    """Return the programs and their arguments."""
    return LaunchDescription(
        [
            *declare_arguments(),
            OpaqueFunction(function=make_server),
            make_bridge(),
            Node(package=PACKAGE, executable="mapper", output="screen"),
            OpaqueFunction(function=make_recorder),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(CONFIG / "simulator.rviz")],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )


def declare_arguments() -> list[Action]:
    """Return what can be set on the command line."""
    return [
        DeclareLaunchArgument(
            "config",
            default_value=str(CONFIG / "simulator.yaml"),
            description="YAML file that describes the world and its cameras.",
        ),
        DeclareLaunchArgument(
            "address",
            default_value="127.0.0.1:50051",
            description="Where the simulator serves gRPC: host:port.",
        ),
        DeclareLaunchArgument(
            "backend",
            default_value="",
            choices=["", "blender", "analytic"],
            description="What renders; empty: as the configuration says.",
        ),
        DeclareLaunchArgument(
            "record",
            default_value="",
            description="true records all topics to a new bag_DATE; a path, to that folder.",
        ),
        DeclareLaunchArgument(
            "rviz",
            default_value="false",
            choices=["true", "false"],
            description="Whether to open RViz with a view of the map.",
        ),
        DeclareLaunchArgument(
            "worker_python",
            default_value="",
            description="Python interpreter that has bpy; empty: the one that runs the server.",
        ),
    ]


def make_server(context: LaunchContext) -> list[Action]:
    """Return the gRPC server; without it nothing works, so its end is the end of all."""
    command = [sys.executable, "-m", "oaisys_grpc", "serve"]
    for argument in ("config", "address", "backend", "worker_python"):
        value = LaunchConfiguration(argument).perform(context)
        if value:
            command += ["--" + argument.replace("_", "-"), value]
    server = ExecuteProcess(
        cmd=command,
        name="simulator",
        output="screen",
        on_exit=Shutdown(reason="the simulator has ended"),
    )
    return [server]


def make_bridge() -> Node:
    """Return the bridge; it waits for the server by itself."""
    address = ParameterValue(LaunchConfiguration("address"), value_type=str)
    return Node(
        package=PACKAGE, executable="bridge", output="screen", parameters=[{"address": address}]
    )


def make_recorder(context: LaunchContext) -> list[Action]:
    """Return a recorder where a folder was named."""
    record = LaunchConfiguration("record").perform(context)
    if record in {"", "false"}:
        return []
    folder = "" if record == "true" else record
    recorder = Node(
        package=PACKAGE,
        executable="recorder",
        output="screen",
        parameters=[{"path": ParameterValue(folder, value_type=str)}],
    )
    return [recorder]
