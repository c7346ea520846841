"""The paths of the set-up."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
INTERPRETER = f"{Path(sys.executable).resolve()} {sys.version}"
PYTHON_VERSION = f"{sys.version_info.major}.{sys.version_info.minor}"
REQUIREMENTS = REPOSITORY / "requirements" / f"py{PYTHON_VERSION.replace('.', '')}.txt"
PYTHON_PACKAGES = tuple(
    REPOSITORY / name
    for name in ("oaisys_core", "oaisys_grpc", "oaisys_mapping", "oaisys_ros_bridge")
)
SETUP = Path(__file__).resolve().parent
UNDERLAY = tuple(
    REPOSITORY / "tools" / "underlay" / name for name in ("tf2_msgs", "simulation_interfaces")
)
"""Interface packages that are built if no wheel contains them."""
OAISYS_MSGS = REPOSITORY / "oaisys_msgs"


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
