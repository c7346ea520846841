"""Whether the compiled packages load, and which system libraries they miss where they do not."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys

from tools.setup.errors import SetupError
from tools.setup.paths import Environment
from tools.setup.variables import process_environment

_MODULES = (
    *("bpy", "cv2", "open3d", "rclpy"),
    *("oaisys_msgs.srv", "simulation_interfaces.srv", "tf2_msgs.msg"),
)
"""Each is imported in a process of its own: some of them do not get on with each other."""

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


def check_libraries(environment: Environment) -> None:
    """Import what set-up installed; as root, first install the system libraries it misses.

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
    """Return why the first module that cannot be imported cannot."""
    for module in _MODULES:
        result = subprocess.run(
            [environment.python, "-c", f"import {module}"],
            env=process_environment(environment),
            capture_output=True,
            text=True,
            check=False,
        )
        if result.returncode:
            lines = result.stderr.strip().splitlines() or [f"exit code {result.returncode}"]
            return f"{module} cannot be imported: {lines[-1]}"
    return None


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
    """Return what the system lacks of all that Blender, Open3D and OpenCV need."""
    files = [
        file
        for package in ("bpy", "open3d", "cv2")
        for file in (environment.site_packages / package).rglob("*.so*")
    ]
    result = subprocess.run(["ldd", *files], capture_output=True, text=True, check=False)
    names = re.findall(r"^\s*(\S+) => not found", result.stdout, re.MULTILINE)
    return sorted({_DEBIAN_PACKAGES[name] for name in names if name in _DEBIAN_PACKAGES})
