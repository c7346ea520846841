"""Runs ``oaisys explore``, which starts server, bridge, mapper and recorder itself."""

from pathlib import Path

from launch import LaunchDescription
from oaisys_ros_bridge.launching.arguments import EXPLORE
from oaisys_ros_bridge.launching.experiments import experiment

CONFIG = Path(__file__).resolve().parents[1] / "config"


def generate_launch_description() -> LaunchDescription:
    """Return the exploration's arguments and its process."""
    return experiment("explore", EXPLORE, CONFIG)
