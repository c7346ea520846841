"""Exploring a rendered terrain: ``oaisys explore``, which starts all it needs by itself."""

from pathlib import Path

from launch import LaunchDescription
from oaisys_ros_bridge.launching.arguments import EXPLORE
from oaisys_ros_bridge.launching.experiments import experiment

CONFIG = Path(__file__).resolve().parents[1] / "config"


def generate_launch_description() -> LaunchDescription:
    """Return the exploration's process and what can be said about it on the command line."""
    return experiment("explore", EXPLORE, CONFIG)
