"""Builds the wheels of all Python packages: `python -m tools.wheels FOLDER`, as `make wheels` does.

They are built from copies, so that the checkout keeps none of setuptools' folders.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from oaisys_core.system.python_programs import python_command
from tools.programs import ROOT

PACKAGES = ("oaisys_core", "oaisys_grpc", "oaisys_mapping", "oaisys_dataset", "oaisys_ros_bridge")
NEEDED = (*PACKAGES, "launch", "config")
"""Folders of the checkout that are copied; the bridge takes the last two along."""

IGNORED = shutil.ignore_patterns("build", "*.egg-info", "*.so", "__pycache__")
TIMEOUT_S = 300.0


def main() -> None:
    """Build into the folder that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m tools.wheels", description=__doc__)
    parser.add_argument("folder", type=Path)
    for wheel in build_wheels(parser.parse_args().folder):
        sys.stdout.write(f"{wheel}\n")


def build_wheels(out: Path) -> list[Path]:
    """Build the wheels of all packages, and return their paths; older wheels are removed.

    Raises:
        subprocess.CalledProcessError: A wheel could not be built.
        subprocess.TimeoutExpired: It took longer than `TIMEOUT_S`.
    """
    out.mkdir(parents=True, exist_ok=True)
    for older in out.glob("oaisys_*.whl"):
        older.unlink()
    with tempfile.TemporaryDirectory() as folder:
        for name in NEEDED:
            shutil.copytree(ROOT / name, Path(folder, name), ignore=IGNORED)
        pip = python_command("pip", "wheel", "--quiet", "--disable-pip-version-check")
        # setuptools and the gRPC generator are those of the project's environment.
        options = ["--no-deps", "--no-build-isolation", "--wheel-dir", str(out.resolve())]
        for name in PACKAGES:
            package = str(Path(folder, name))
            subprocess.run([*pip, *options, package], check=True, timeout=TIMEOUT_S)
    return sorted(out.glob("oaisys_*.whl"))


if __name__ == "__main__":
    main()
