"""The virtual environment: its paths, and the variables that programs in it need."""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
INTERPRETER = f"{sys.base_prefix} {sys.version}"
"""The same for an environment's own Python, which may be a copy of its base."""
PYTHON_VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
REQUIREMENTS = REPOSITORY / "requirements" / f"py{PYTHON_VERSION.replace('.', '')}.txt"
PYTHON_PACKAGES = tuple(
    REPOSITORY / name
    for name in (
        "oaisys_core",
        "oaisys_dataset",
        "oaisys_grpc",
        "oaisys_gym",
        "oaisys_mapping",
        "oaisys_ros_bridge",
    )
)
VERSION = REPOSITORY / "VERSION"
"""The version of all packages, each of which has a link to it."""
SETUP = Path(__file__).resolve().parent
UNDERLAY = tuple(
    REPOSITORY / "tools" / "underlay" / name
    for name in (
        "tf2_msgs",
        "simulation_interfaces",
        "stereo_msgs",
        "vision_msgs",
        "grid_map_msgs",
    )
)
"""Interface packages that are built if no wheel contains them."""
OAISYS_MSGS = REPOSITORY / "oaisys_msgs"

_SCRIPT = """\
# Written by `make setup`. Source it in bash or zsh: afterwards `oaisys`, `pytest` and every Python
# program of the environment find Blender, the ROS libraries and each other.
{exports}
# Another ROS install or environment would shadow this one's packages.
unset PYTHONPATH PYTHONHOME
# Containers often forbid bytecode to be kept; each program then starts two to three times slower.
unset PYTHONDONTWRITEBYTECODE
case ":$PATH:" in
    *":$VIRTUAL_ENV/bin:"*) ;;
    *) export PATH="$VIRTUAL_ENV/bin:$PATH" ;;
esac
# Discovery stays on this machine unless the caller wants otherwise.
export ROS_AUTOMATIC_DISCOVERY_RANGE="${{ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}}"
# rclpy fails to start where it cannot write its log. Never under a name that others can foresee.
if [ ! -w "${{HOME:-/nonexistent}}" ] && [ -z "${{ROS_LOG_DIR:-}}" ]; then
    if [ "$(stat -c '%F %u %a' "${{XDG_RUNTIME_DIR:-}}" 2>&1)" = "directory $(id -u) 700" ]; then
        export ROS_LOG_DIR="$XDG_RUNTIME_DIR/oaisys-ros-log"
    else
        ROS_LOG_DIR="$(mktemp -d "${{TMPDIR:-/tmp}}/oaisys-ros-log-XXXXXXXX")" && export ROS_LOG_DIR
    fi
fi
"""


@dataclass(frozen=True)
class Environment:
    """The virtual environment, which is also a ROS prefix.

    Attributes:
        root: Its absolute path.
    """

    root: Path

    @property
    def python(self) -> Path:
        """The environment's interpreter."""
        return self.root / "bin" / "python"

    @property
    def site_packages(self) -> Path:
        """The folder into which pip installs packages."""
        return self.root / "lib" / f"python{PYTHON_VERSION}" / "site-packages"

    @property
    def state(self) -> Path:
        """The folder of the set-up: stamps, temporary files, build trees."""
        return self.root / "oaisys"

    @property
    def script(self) -> Path:
        """The script that a shell sources."""
        return self.root / "oaisys_env.sh"


def ros_variables(environment: Environment) -> dict[str, str]:
    """Return the variables, in a fixed order, that programs of ``environment`` need."""
    root = environment.root
    libraries = [root / "lib", *sorted(environment.site_packages.glob("ros_*.libs"))]
    return {
        "VIRTUAL_ENV": str(root),
        "AMENT_PREFIX_PATH": str(root),
        "CMAKE_PREFIX_PATH": str(root),
        "LD_LIBRARY_PATH": os.pathsep.join(map(str, libraries)),
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_DISTRO": "jazzy",
        "ROS_PYTHON_VERSION": "3",
        "ROS_VERSION": "2",
        # Unless this is set, the wheels start Python again to set the library path.
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }


def process_environment(environment: Environment) -> dict[str, str]:
    """Return the environment variables for a child process inside ``environment``."""
    return {
        **os.environ,
        **ros_variables(environment),
        "PATH": f"{environment.root / 'bin'}{os.pathsep}{os.environ.get('PATH', os.defpath)}",
    }


def write_script(environment: Environment) -> None:
    """Write the script that a shell sources."""
    exports = "\n".join(
        f"export {name}={shlex.quote(value)}" for name, value in ros_variables(environment).items()
    )
    environment.script.write_text(_SCRIPT.format(exports=exports))
