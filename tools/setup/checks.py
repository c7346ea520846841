"""What set-up checks: disk space and a compiler first, the compiled packages at the end."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tools.setup.environment import Environment, process_environment
from tools.setup.errors import SetupError

NEEDED_DISK_GB = 6.0
"""4 GB for the environment, and up to 2 GB of wheels while they are unpacked."""

_TRIAL_SOURCES = {
    "trial.c": '#include <stdio.h>\nint main(void) { return puts("") < 0; }\n',
    "trial.cpp": '#include <string>\nint main() { return std::string("").size(); }\n',
}

_MODULES = (
    *("bpy", "cv2", "open3d", "rclpy"),
    *("oaisys_msgs.srv", "simulation_interfaces.srv", "tf2_msgs.action", "tf2_msgs.srv"),
    *("grid_map_msgs.msg", "stereo_msgs.msg", "vision_msgs.msg"),
)
"""Each is imported in its own process, because some of them conflict."""

_DEBIAN_PACKAGES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libGLX.so.0": "libglx0",
    "libICE.so.6": "libice6",
    "libOpenGL.so.0": "libopengl0",
    "libSM.so.6": "libsm6",
    "libX11.so.6": "libx11-6",
    "libXext.so.6": "libxext6",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXrender.so.1": "libxrender1",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libgomp.so.1": "libgomp1",
    "libidn2.so.0": "libidn2-0",
    "libudev.so.1": "libudev1",
    "libxkbcommon.so.0": "libxkbcommon0",
}


def check_disk(folder: Path, needed_gb: float, held_gb: Callable[[], float] = lambda: 0.0) -> None:
    """Raise `SetupError` if the file system of ``folder`` has less than ``needed_gb`` free.

    Args:
        folder: A folder on it, which need not exist.
        needed_gb: What is needed in the end.
        held_gb: How much of it is on the disk already; asked only if there might be too little.
    """
    free_gb = shutil.disk_usage(existing_folder(folder)).free / 1e9
    if free_gb < needed_gb and free_gb < (missing_gb := needed_gb - held_gb()):
        raise SetupError(
            f"not enough disk space for {folder}: {free_gb:.1f} GB free, {missing_gb:.0f} GB needed"
        )


def existing_folder(folder: Path) -> Path:
    """Return ``folder``, or the nearest folder above it that exists."""
    return next(path for path in (folder, *folder.parents) if path.is_dir())


def folder_gb(folder: Path) -> float:
    """Return the size of the files in ``folder``, which need not exist."""
    return sum(file.lstat().st_size for file in folder.rglob("*")) / 1e9


def check_compiler() -> None:
    """Raise `SetupError` if C and C++ programs cannot be compiled and linked.

    ``CC`` and ``CXX`` are honoured, as CMake does.
    """
    _compile("C", os.environ.get("CC"), ("cc", "gcc", "clang"), "trial.c")
    _compile("C++", os.environ.get("CXX"), ("c++", "g++", "clang++"), "trial.cpp")


def _compile(language: str, chosen: str | None, usual: tuple[str, ...], source: str) -> None:
    commands = [shlex.split(chosen)] if chosen else [[name] for name in usual]
    found = next((command for command in commands if shutil.which(command[0])), None)
    if found is None:
        names = chosen or ", ".join(usual)
        raise SetupError(f"no {language} compiler found ({names}): apt install build-essential")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, source)
        file.write_text(_TRIAL_SOURCES[source])
        result = subprocess.run(
            [*found, str(file), "-o", str(Path(folder, "trial"))],
            capture_output=True,
            text=True,
            check=False,
        )
    if result.returncode:
        fault = next((line for line in result.stderr.splitlines() if "error" in line), "no message")
        raise SetupError(f"the {language} compiler {found[0]} does not work: {fault.strip()}")


def check_libraries(environment: Environment) -> None:
    """Import the installed packages; as root, install missing system libraries first.

    Raises:
        SetupError: A module cannot be imported; names every missing system library.
    """
    fault = _first_fault(environment)
    if fault is None:
        return
    packages = _missing_debian_packages(environment)
    if not packages:
        raise SetupError(fault)
    if not _can_install():
        raise SetupError(f"system libraries are missing: apt install {' '.join(packages)}")
    _install(packages)
    fault = _first_fault(environment)
    if fault is not None:
        raise SetupError(fault)


def _first_fault(environment: Environment) -> str | None:
    """Return why a module cannot be imported, for the first such module."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        faults = pool.map(lambda module: _fault(environment, module), _MODULES)
        return next((fault for fault in faults if fault is not None), None)


def _fault(environment: Environment, module: str) -> str | None:
    """Return why a module cannot be imported, or None."""
    result = subprocess.run(
        [environment.python, "-P", "-c", f"import {module}"],
        env=process_environment(environment),
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode == 0:
        return None
    lines = result.stderr.strip().splitlines() or [f"exit code {result.returncode}"]
    return f"{module} cannot be imported: {lines[-1]}"


def _can_install() -> bool:
    return os.geteuid() == 0 and shutil.which("apt-get") is not None


def _install(packages: list[str]) -> None:
    print(f"setup: installing system libraries: {' '.join(packages)}", file=sys.stderr, flush=True)
    variables = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    install = ["apt-get", "install", "--yes", "--quiet", "--no-install-recommends", *packages]
    for command in (["apt-get", "update", "--quiet"], install):
        result = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
        if result.returncode:
            sys.stderr.write(result.stderr)
            raise SetupError(f"{' '.join(command)} failed: install {' '.join(packages)} yourself")


def _missing_debian_packages(environment: Environment) -> list[str]:
    """Return the missing Debian packages that Blender, Open3D and OpenCV need."""
    files = [
        file
        for package in ("bpy", "open3d", "cv2")
        for file in (environment.site_packages / package).rglob("*.so*")
    ]
    result = subprocess.run(["ldd", *files], capture_output=True, text=True, check=False)
    names = re.findall(r"^\s*(\S+) => not found", result.stdout, re.MULTILINE)
    return sorted({_DEBIAN_PACKAGES[name] for name in names if name in _DEBIAN_PACKAGES})
