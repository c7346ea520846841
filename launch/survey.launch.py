"""Runs ``oaisys survey``, which starts server, bridge, mapper and recorder itself."""

from pathlib import Path

from launch import LaunchDescription
from oaisys_ros_bridge.launching.arguments import SURVEY
from oaisys_ros_bridge.launching.experiments import experiment

CONFIG = Path(__file__).resolve().parents[1] / "config"


def generate_launch_description() -> LaunchDescription:
    """Return the survey's arguments and its process."""
    return experiment("survey", SURVEY, CONFIG)
