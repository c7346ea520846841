"""``ros2 launch`` in a process of its own, ended as Ctrl-C at a terminal ends it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Self

from repository import REPOSITORY
from waiting import START_PATIENCE_S, wait_until

LAUNCH = """
import sys
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch import LaunchDescription

file, *arguments = sys.argv[1:]
source = PythonLaunchDescriptionSource(file)
pairs = [argument.split(":=", 1) for argument in arguments]
service = LaunchService()
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=pairs)])
)
sys.exit(service.run())
"""
"""What ``ros2 launch`` does, for machines that have the launch system but not that command."""


class Launched:
    """A launch file that runs; a context manager. What it prints goes to a file."""

    def __init__(self, name: str, folder: Path, **arguments: object) -> None:
        self.log = folder / f"{name}.launch.log"
        given = [f"{key}:={value}" for key, value in arguments.items()]
        file = REPOSITORY / "launch" / f"{name}.launch.py"
        with self.log.open("w") as output:
            # A terminal's Ctrl-C reaches a whole foreground group: so does `interrupt`.
            self.process = subprocess.Popen(
                [sys.executable, "-c", LAUNCH, str(file), *given],
                stdout=output,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env={**os.environ, "ROS_LOG_DIR": str(folder / "ros-log")},
                start_new_session=True,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.interrupt()
        self.process.kill()
        self.process.wait()

    def wait_for(self, text: str) -> None:
        """Wait until it has printed a text."""
        wait_until(
            lambda: text in self.log.read_text(),
            START_PATIENCE_S,
            process=self.process,
            explain=self.log.read_text,
        )

    def interrupt(self) -> int:
        """Press Ctrl-C and return its exit code."""
        os.killpg(self.process.pid, signal.SIGINT)
        return self.process.wait(START_PATIENCE_S)
