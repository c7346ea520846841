"""Reads memory, file descriptors, threads and shared memory of the running processes."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import psutil

NAMES = {
    "oaisys_grpc.worker": "worker",
    "oaisys_grpc": "server",
    "oaisys_ros_bridge.nodes.bridge": "bridge",
    "oaisys_ros_bridge.nodes.mapper": "mapper",
    "oaisys_ros_bridge.nodes.recorder": "recorder",
}
"""Names of processes in the table, by the module that they run."""

_SHARED = re.compile(r"(\S+ \d+) +(?:/dev/shm/|/memfd:)")
"""Device and inode of shared memory in a line of ``/proc/PID/maps``."""


@dataclass(frozen=True)
class Gauge:
    """Resources of a process at one time.

    Attributes:
        pss_mb: Proportional set size: shared memory is divided among its users.
        private_mb: Memory that is not shared.
        descriptors: Open file descriptors.
        threads: Running threads.
        shared_segments: Mapped files in shared memory.
    """

    pss_mb: float
    private_mb: float
    descriptors: int
    threads: int
    shared_segments: int


def read_gauges(root: psutil.Process) -> Mapping[str, Gauge]:
    """Return the gauges of the known processes below ``root``, by name."""
    gauges = {}
    for process in root.children(recursive=True):
        with contextlib.suppress(psutil.Error, OSError):
            if name := _name_of(process.cmdline()):
                gauges[name] = _gauge_of(process)
    return gauges


def _name_of(command: list[str]) -> str:
    """Return a process's name in the table; empty: it is not a known process."""
    return next((name for module, name in NAMES.items() if module in command), "")


def _gauge_of(process: psutil.Process) -> Gauge:
    memory = process.memory_full_info()
    maps = Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8")
    return Gauge(
        pss_mb=memory.pss / 1e6,
        private_mb=memory.uss / 1e6,
        descriptors=process.num_fds(),
        threads=process.num_threads(),
        shared_segments=len(set(_SHARED.findall(maps))),
    )
