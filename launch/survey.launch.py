"""The survey of a rendered terrain: ``oaisys survey``, which starts all it needs by itself."""

from pathlib import Path

from launch import LaunchDescription
from oaisys_ros_bridge.launching.arguments import Argument
from oaisys_ros_bridge.launching.experiments import experiment

CONFIG = Path(__file__).resolve().parents[1] / "config"
OPTIONS = {
    "out": Argument("out/survey", "Folder for report, mesh, pictures and bag."),
    "views": Argument("30", "Viewpoints on the grid."),
}


def generate_launch_description() -> LaunchDescription:
    """Return the survey's process and what can be said about it on the command line."""
    return experiment("survey", OPTIONS, CONFIG)
