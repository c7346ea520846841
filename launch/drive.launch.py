"""Starts simulator, bridge and recorder, drives once, and ends with the drive's exit code."""

from functools import partial
from pathlib import Path

from launch.actions import OpaqueFunction

from launch import LaunchDescription
from oaisys_ros_bridge.launching.actions import declare
from oaisys_ros_bridge.launching.arguments import DRIVE
from oaisys_ros_bridge.launching.drives import start_drive

CONFIG = Path(__file__).resolve().parents[1] / "config"


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the programs."""
    start = partial(start_drive, config_folder=CONFIG)
    return LaunchDescription([*declare(DRIVE), OpaqueFunction(function=start)])
