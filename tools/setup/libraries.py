"""Whether the compiled packages load, and which system libraries they miss where they do not."""

from __future__ import annotations

import re
import subprocess

from tools.setup.errors import SetupError
from tools.setup.paths import Environment
from tools.setup.variables import process_environment

_MODULES = ("bpy", "cv2", "open3d", "rclpy", "oaisys_msgs.srv", "tf2_msgs.msg")
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
    "libxkbcommon.so.0": "libxkbcommon0",
}


def check_libraries(environment: Environment) -> None:
    """Import what set-up installed.

    Raises:
        SetupError: A module cannot be imported; names every missing system library.
    """
    for module in _MODULES:
        result = subprocess.run(
            [environment.python, "-c", f"import {module}"],
            env=process_environment(environment),
            capture_output=True,
            text=True,
            check=False,
        )
        if result.returncode == 0:
            continue
        packages = _missing_debian_packages(environment)
        if packages:
            raise SetupError(f"system libraries are missing: apt install {' '.join(packages)}")
        lines = result.stderr.strip().splitlines() or [f"exit code {result.returncode}"]
        raise SetupError(f"{module} cannot be imported: {lines[-1]}")


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
