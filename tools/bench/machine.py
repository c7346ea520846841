"""The machine that the figures were measured on, and the memory of its processes."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import psutil

MEGABYTE = 1e6


def machine() -> dict[str, str]:
    """Return a description of the machine, its load and the versions."""
    return {
        "processor": _processor(),
        "cores": f"{len(os.sched_getaffinity(0))} of {os.cpu_count()}",
        "memory": f"{psutil.virtual_memory().total / MEGABYTE:.0f} MB",
        "load at the start": "{:.2f} {:.2f} {:.2f}".format(*os.getloadavg()),
        "system": platform.platform(),
        "python": platform.python_version(),
        "bpy": _version("bpy"),
        "open3d": _version("open3d"),
        "commit": _commit(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _commit() -> str:
    """Return the commit, and whether files differ from it; empty outside a repository."""
    folder = Path(__file__).parent
    commands = ["git", "rev-parse", "--short", "HEAD"], ["git", "status", "--porcelain", "-uno"]
    try:
        commit, changes = (
            subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout
            for command in commands
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return commit.strip() + (" with changes" if changes.strip() else "")


def peak_memory_mb(process: str = "self") -> float:
    """Return the largest resident memory that a process has had so far."""
    for line in Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / MEGABYTE
    raise ValueError(f"/proc/{process}/status says nothing of VmHWM")


def memory_mb() -> float:
    """Return the resident memory that this process has now."""
    return float(psutil.Process().memory_info().rss) / MEGABYTE
