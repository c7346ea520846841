"""Starts simulator, bridge and mapper, and optionally a recorder and RViz."""

from functools import partial
from pathlib import Path

from launch.actions import OpaqueFunction

from launch import LaunchDescription
from oaisys_ros_bridge.launching.actions import declare
from oaisys_ros_bridge.launching.arguments import SIMULATOR
from oaisys_ros_bridge.launching.simulator import start_simulator

CONFIG = Path(__file__).resolve().parents[1] / "config"


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the programs."""
    start = partial(start_simulator, config_folder=CONFIG)
    return LaunchDescription([*declare(SIMULATOR), OpaqueFunction(function=start)])
