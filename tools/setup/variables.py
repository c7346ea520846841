"""The environment variables that the ROS wheels need, for a process and as a shell script."""

from __future__ import annotations

import os
import shlex

from tools.setup.paths import Environment

_SCRIPT = """\
# Written by `make setup`. Source it in bash or zsh: afterwards `oaisys`, `pytest` and every Python
# program of the environment find Blender, the ROS libraries and each other.
{exports}
# Another ROS install or environment would shadow this one's packages.
unset PYTHONPATH PYTHONHOME
case ":$PATH:" in
    *":$VIRTUAL_ENV/bin:"*) ;;
    *) export PATH="$VIRTUAL_ENV/bin:$PATH" ;;
esac
# Discovery stays on this machine unless the caller wants otherwise.
export ROS_AUTOMATIC_DISCOVERY_RANGE="${{ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}}"
# rclpy fails to start where it cannot write its log.
if [ ! -w "${{HOME:-/nonexistent}}" ]; then
    export ROS_LOG_DIR="${{ROS_LOG_DIR:-${{TMPDIR:-/tmp}}/oaisys-ros-log-$(id -u)}}"
fi
"""


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
