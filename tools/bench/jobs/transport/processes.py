"""Server and bridge as processes beside a job."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import yaml

from oaisys_core.system.processes import ManagedProcess
from oaisys_core.system.python_programs import python_command
from tools.bench.settings import Settings

START_TIMEOUT_S = 300.0
WORKER = "oaisys_grpc.worker"
SERVER = "oaisys_grpc serve"
BRIDGE = "oaisys_ros_bridge.nodes.bridge"

SMALL_WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"preset": "mounds", "extent_m": 40.0, "resolution_px": 129},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64}},
    "assets": {"rocks": [{"count": [20, 20]}]},
}
"""Renders in milliseconds, for jobs that measure the transport of images only."""


@contextmanager
def server(settings: Settings, world: Mapping[str, Any], *options: str) -> Iterator[str]:
    """Run a server on a free port and yield its address."""
    file = settings.out / "logs" / "world.yaml"
    file.write_text(yaml.safe_dump(dict(world)), encoding="utf-8")
    command = ["oaisys_grpc", "serve", "--config", str(file), "--address", "127.0.0.1:0"]
    with _process(settings, "server", *command, *options) as process:
        yield process.wait_for_line("ready:", START_TIMEOUT_S)


@contextmanager
def bridge(settings: Settings, address: str) -> Iterator[None]:
    """Run a bridge to a server, in this process's ROS domain."""
    with _process(settings, "bridge", BRIDGE, "--ros-args", "-p", f"address:={address}"):
        yield


def choose_ros_domain() -> None:
    """Isolate this process and its children from other ROS programs, before rclpy starts."""
    os.environ["ROS_DOMAIN_ID"] = str(random.SystemRandom().randint(1, 101))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


def child(text: str) -> psutil.Process:
    """Return the descendant of this process with a text in its command line.

    Raises:
        LookupError: There is none.
    """
    for process in psutil.Process().children(recursive=True):
        if text in " ".join(process.cmdline()):
            return process
    raise LookupError(f"no process below this one runs {text}")


def _process(settings: Settings, name: str, *arguments: str) -> ManagedProcess:
    log: Path = settings.out / "logs" / f"{name}.log"
    return ManagedProcess(name, python_command(*arguments), log, os.environ)
