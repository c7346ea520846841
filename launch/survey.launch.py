"""The survey of a rendered terrain: ``oaisys survey``, which starts all it needs by itself."""

import sys

from launch.action import Action
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

from launch import LaunchContext, LaunchDescription

OPTIONS = {
    "out": ("out/survey", "Folder for report, mesh, pictures and bag."),
    "config": ("", "YAML file that describes the world; empty: the default world."),
    "backend": ("", "What renders, blender or analytic; empty: as the configuration says."),
    "views": ("30", "Viewpoints on the grid."),
    "size": ("", "WIDTHxHEIGHT of the images, for a quick look; empty: as configured."),
    "quality": ("", "Of colour, preview to final; empty: as configured."),
    "worker_python": ("", "Python interpreter that has bpy; empty: the one that runs the server."),
}
"""Launch arguments, each an option of the command: default and description."""


def generate_launch_description() -> LaunchDescription:
    """Return the survey's process and what can be said about it on the command line."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in OPTIONS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=make_survey)])


def make_survey(context: LaunchContext) -> list[Action]:
    """Return the survey with the options that were given."""
    command = [sys.executable, "-m", "oaisys_core", "survey"]
    for name in OPTIONS:
        value = LaunchConfiguration(name).perform(context)
        if value:
            command += ["--" + name.replace("_", "-"), value]
    return [ExecuteProcess(cmd=command, name="survey", output="screen")]
