"""What a machine has that the simulator needs or can use."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from oaisys_core.errors import InvalidInputError, quote

State = Literal["ok", "optional", "missing"]

BLENDER_BY_PYTHON = {(3, 11): "4.5.15", (3, 13): "5.2.3"}
"""The one version of the package bpy for each Python that has one."""

LEAST_MEMORY_GB = 4.0
"""What a worker and its server need with the default world, with room for the desktop."""

LEAST_SHARED_MEMORY_MB = 64.0
"""What ROS and pixels in shared memory take at 640 x 480; containers have this by default."""

LEAST_DISK_GB = 2.0
"""Room for a survey's bag and the cache of textures."""

LAST_DOMAIN = 232
"""Of ROS: the ports of higher ones would be above 65535."""

GPU_TIMEOUT_S = 120.0
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "firefox")

PACKAGES: dict[str, tuple[str, State, str]] = {
    "numpy": ("arrays", "missing", "pip install numpy"),
    "open3d": ("rays and maps", "missing", "pip install 'oaisys_core[simulator]'"),
    "opencv-contrib-python-headless": ("images", "missing", "pip install 'oaisys_core[simulator]'"),
    "rasterio": ("elevation models", "missing", "pip install 'oaisys_core[simulator]'"),
    "grpcio": ("servers and clients", "optional", "pip install oaisys_grpc"),
    "oaisys_mapping": ("maps and certificates", "optional", "pip install oaisys_mapping"),
    "oaisys_dataset": ("data sets", "optional", "pip install oaisys_dataset"),
    "ray": ("data sets on many cores", "optional", "pip install 'oaisys_dataset[all]'"),
    "torch": ("training, tutorial 07", "optional", "pip install torch"),
}
"""Packages by name: what for, what it is if missing, and the line that installs it."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked for.

    Attributes:
        name: What it is.
        state: ``ok``, ``missing`` (it is needed) or ``optional`` (not there; a part needs it).
        found: What was found.
        remedy: The line that installs it or makes it right; empty if nothing is to do.
    """

    name: str
    state: State
    found: str
    remedy: str = ""


def examine_machine(address: str) -> list[Finding]:
    """Return what was found, in the order in which a person would look.

    Args:
        address: HOST:PORT that a server would listen at.

    Raises:
        InvalidInputError: The address is none.
    """
    _require_address(address)
    checks: dict[str, Callable[[], Finding]] = {
        "Python": _python,
        **{name: partial(_package, name) for name in PACKAGES},
        "Blender (bpy)": _blender,
        "GPU": _gpu,
        "memory": _memory,
        "shared memory": partial(_shared_memory, Path("/dev/shm")),  # noqa: S108
        "temporary files": _temporary_folder,
        "disk": _disk,
        "port": partial(_port, address),
        "ROS 2": _ros,
        "browser": _browser,
    }
    return [_examine(name, check) for name, check in checks.items()]


def _examine(name: str, check: Callable[[], Finding]) -> Finding:
    """Return what a check finds, or that the machine does not let it look."""
    try:
        return check()
    except (OSError, ValueError, RuntimeError, MemoryError, ImportError) as error:
        what = f"{type(error).__name__}: {quote(str(error))}"
        return Finding(name, "optional", f"cannot be examined here: {what}")


def _python() -> Finding:
    here = f"{platform.python_version()} on {platform.machine()}, {os.cpu_count()} cores"
    if sys.version_info[:2] in BLENDER_BY_PYTHON:
        return Finding("Python", "ok", here)
    remedy = "uv python install 3.13  (this one can serve ROS; Blender's worker needs 3.11 or 3.13)"
    return Finding("Python", "optional", f"{here}; Blender has no package for it", remedy)


def _package(name: str) -> Finding:
    use, state, remedy = PACKAGES[name]
    try:
        return Finding(name, "ok", f"{version(name)}, for {use}")
    except PackageNotFoundError:
        return Finding(name, state, f"not installed, for {use}", remedy)


def _blender() -> Finding:
    try:
        return Finding("Blender (bpy)", "ok", version("bpy"))
    except PackageNotFoundError:
        wanted = BLENDER_BY_PYTHON.get(sys.version_info[:2])
        remedy = f"pip install bpy=={wanted}" if wanted else "see Python above"
        found = "not installed: only the backend analytic renders here"
        return Finding("Blender (bpy)", "optional", found, remedy)


def _gpu() -> Finding:
    """Ask Blender in a process of its own: drivers can crash it."""
    if find_spec("bpy") is None:
        return Finding("GPU", "optional", "unknown without Blender", "install Blender, see above")
    code = (
        "import json, sys\n"
        "from oaisys_core.render.blender.devices import gpu_names\n"
        "found = gpu_names()\n"
        "print('\\n' + json.dumps(found))"
    )
    try:
        ended = subprocess.run(
            [sys.executable, "-P", "-c", code],
            capture_output=True,
            text=True,
            timeout=GPU_TIMEOUT_S,
            check=True,
        )
        found: dict[str, list[str]] = json.loads(ended.stdout.splitlines()[-1])
    except (OSError, subprocess.SubprocessError, ValueError, IndexError) as error:
        text = f"Blender did not say: {type(error).__name__}"
        return Finding("GPU", "optional", text, 'python -c "import bpy"  (shows why)')
    if not found:
        remedy = "install the GPU's driver if there is a GPU; the CPU renders the same images"
        return Finding("GPU", "optional", "none that Cycles can use", remedy)
    shown = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in found.items())
    return Finding("GPU", "ok", shown)


def _memory() -> Finding:
    free_gb = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    total_gb = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    found = f"{total_gb:.1f} GB, {free_gb:.1f} GB of it unused"
    if total_gb >= LEAST_MEMORY_GB:
        return Finding("memory", "ok", found)
    remedy = f"at least {LEAST_MEMORY_GB:g} GB are needed for the default world; make it smaller"
    return Finding("memory", "missing", found, remedy)


def _shared_memory(folder: Path) -> Finding:
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        found = f"{folder} cannot be written: pixels go through connections, ROS over UDP"
        return Finding("shared memory", "optional", found, "docker run --shm-size=1g …")
    free_mb = shutil.disk_usage(folder).free / 1e6
    found = f"{free_mb:.0f} MB free in {folder}"
    if free_mb >= LEAST_SHARED_MEMORY_MB:
        return Finding("shared memory", "ok", found)
    remedy = f"rm {folder}/fastrtps_*  (left by killed ROS programs), or docker run --shm-size=1g …"
    return Finding("shared memory", "optional", found, remedy)


def _temporary_folder() -> Finding:
    wanted = next((os.environ[key] for key in ("TMPDIR", "TEMP", "TMP") if os.environ.get(key)), "")
    wanted = wanted or "/tmp"  # noqa: S108
    try:
        used = tempfile.gettempdir()
    except FileNotFoundError:
        remedy = "export TMPDIR=...  (a folder of yours with room)"
        return Finding("temporary files", "missing", f"no folder takes any: {wanted} ...", remedy)
    if Path(used) == Path(wanted).absolute():
        return Finding("temporary files", "ok", f"in {used}")
    found = f"{quote(wanted)} takes none (no such folder, not yours, or full): {used} is used"
    return Finding("temporary files", "optional", found, "make room there, or set TMPDIR")


def _disk() -> Finding:
    try:
        folder = Path.cwd()
    except FileNotFoundError:
        found = "the current folder has been removed"
        return Finding("disk", "missing", found, "cd to a folder that exists")
    free_gb = shutil.disk_usage(folder).free / 1e9
    found = f"{free_gb:.1f} GB free in {folder}"
    if free_gb >= LEAST_DISK_GB:
        return Finding("disk", "ok", found)
    return Finding("disk", "missing", found, f"make room: {LEAST_DISK_GB:g} GB are needed")


def _require_address(address: str) -> None:
    """Raise `InvalidInputError` unless an address has a host and a port."""
    _, colon, port = address.rpartition(":")
    if not (colon and re.fullmatch("[0-9]{1,5}", port) and int(port) < 65536):
        raise InvalidInputError("address", address, "HOST:PORT with a port from 0 to 65535")


def _port(address: str) -> Finding:
    host, _, port = address.rpartition(":")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((host.strip("[]"), int(port)))
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or quote(str(error))
            found = f"{quote(address)} cannot be used: {reason}"
            remedy = "oaisys serve --address 127.0.0.1:0  (any free port)"
            return Finding("port", "optional", found, remedy)
    return Finding("port", "ok", f"{address} is free")


def _ros() -> Finding:
    distribution = os.environ.get("ROS_DISTRO", "")
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    missing = [name for name in ("rclpy", "oaisys_msgs") if find_spec(name) is None]
    if not missing and not (re.fullmatch("[0-9]{1,3}", domain) and int(domain) <= LAST_DOMAIN):
        found = f"ROS_DOMAIN_ID is {quote(domain)}, expected a number from 0 to {LAST_DOMAIN}"
        return Finding("ROS 2", "optional", found, "unset ROS_DOMAIN_ID")
    if not missing:
        return Finding("ROS 2", "ok", f"{distribution or 'unnamed'}, domain {domain}")
    remedy = "source .venv/oaisys_env.sh  (after make setup), or colcon build"
    return Finding("ROS 2", "optional", f"{', '.join(missing)} cannot be imported", remedy)


def _browser() -> Finding:
    for name in BROWSERS:
        if path := shutil.which(name):
            return Finding("browser", "ok", path)
    remedy = "sudo apt install chromium  (or open reports on another machine)"
    return Finding("browser", "optional", f"none of {', '.join(BROWSERS)}", remedy)
