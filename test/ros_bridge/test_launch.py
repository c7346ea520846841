"""The launch files, where ROS's launch system is installed."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

launch_ros = pytest.importorskip("launch_ros", reason="ROS's launch system is not installed")

LAUNCH_FILES = sorted((Path(__file__).resolve().parents[2] / "launch").glob("*.launch.py"))


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_a_launch_file_describes_its_arguments(file: Path) -> None:
    description = runpy.run_path(str(file))["generate_launch_description"]()

    arguments: list[Any] = description.get_launch_arguments()
    assert arguments
    assert all(argument.description for argument in arguments)


def test_the_simulator_has_the_promised_arguments() -> None:
    file = next(file for file in LAUNCH_FILES if file.name == "simulator.launch.py")
    description = runpy.run_path(str(file))["generate_launch_description"]()

    names = {argument.name for argument in description.get_launch_arguments()}
    assert names == {"config", "address", "backend", "record", "rviz", "worker_python"}
