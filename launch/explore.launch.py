"""Exploring a rendered terrain: ``oaisys explore``, which starts all it needs by itself."""

import sys

from launch.action import Action
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

from launch import LaunchContext, LaunchDescription

OPTIONS = {
    "out": ("out/explore", "Folder for report, mesh, pictures and bag."),
    "config": ("", "YAML file that describes the world; empty: a steep hill."),
    "backend": ("", "What renders, blender or analytic; empty: as the configuration says."),
    "planner": ("next_best_view", "next_best_view, frontier, grid, random, or a package's."),
    "views": ("60", "Most views of an exploration."),
    "size": ("", "WIDTHxHEIGHT of the images, for a quick look; empty: as configured."),
    "quality": ("", "Of colour, preview to final; empty: as configured."),
    "worker_python": ("", "Python interpreter that has bpy; empty: the one that runs the server."),
}
"""Launch arguments, each an option of the command: default and description."""


def generate_launch_description() -> LaunchDescription:
    """Return the exploration's process and what can be said about it on the command line."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in OPTIONS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=make_explore)])


def make_explore(context: LaunchContext) -> list[Action]:
    """Return the exploration with the options that were given."""
    command = [sys.executable, "-m", "oaisys_core", "explore"]
    for name in OPTIONS:
        value = LaunchConfiguration(name).perform(context)
        if value:
            command += ["--" + name.replace("_", "-"), value]
    return [ExecuteProcess(cmd=command, name="explore", output="screen")]
