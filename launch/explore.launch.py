"""Exploring a rendered terrain: ``oaisys explore``, which starts all it needs by itself."""

from pathlib import Path

from launch import LaunchDescription
from oaisys_ros_bridge.launching.arguments import Argument
from oaisys_ros_bridge.launching.experiments import experiment

CONFIG = Path(__file__).resolve().parents[1] / "config"
OPTIONS = {
    "out": Argument("out/explore", "Folder for report, mesh, pictures and bag."),
    "planner": Argument(
        "next_best_view", "next_best_view, frontier, grid, random, or a package's; all: those."
    ),
    "seeds": Argument("1", "How many worlds, or their seeds with commas between them."),
    "via": Argument("service", "How poses are asked for: service or trajectory."),
    "views": Argument("60", "Most views of an exploration."),
}


def generate_launch_description() -> LaunchDescription:
    """Return the exploration's process and what can be said about it on the command line."""
    return experiment("explore", OPTIONS, CONFIG)
