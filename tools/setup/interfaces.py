"""Builds the ROS interfaces that no wheel contains, with colcon."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from tools.setup.errors import SetupError
from tools.setup.paths import OAISYS_MSGS, UNDERLAY, Environment
from tools.setup.progress import colcon_progress, run_with_progress
from tools.setup.variables import process_environment


def build_interfaces(environment: Environment) -> None:
    """Build ``oaisys_msgs`` and the packages of the underlay that the wheels lack.

    Raises:
        SetupError: The build failed; its output was shown.
    """
    build = environment.state / "build"
    _remove_installed(build)
    share = environment.root / "share"
    missing = [path for path in UNDERLAY if not (share / path.name / "package.xml").is_file()]
    sources = [OAISYS_MSGS, *missing]
    python = environment.python
    command: list[str | Path] = [environment.root / "bin" / "colcon"]
    command += ["--log-base", environment.state / "log", "build", "--merge-install"]
    command += ["--build-base", build, "--install-base", environment.root]
    command += ["--base-paths", *sources]
    command += ["--event-handlers", "console_cohesion-", "console_package_list-"]
    command += ["--cmake-args", "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF"]
    command += [f"-DPython3_EXECUTABLE={python}", f"-DPYTHON_EXECUTABLE={python}", "-Wno-dev"]
    log = environment.state / "colcon.log"
    code = run_with_progress(
        command,
        process_environment(environment),
        log,
        lambda said: colcon_progress(said, len(sources), build),
    )
    if code:
        sys.stderr.write(log.read_text(errors="replace"))
        raise SetupError("building the ROS interfaces failed")


def _remove_installed(build: Path) -> None:
    """Remove the files of earlier builds, so that renamed messages leave nothing behind."""
    for manifest in build.glob("*/install_manifest.txt"):
        for file in manifest.read_text().splitlines():
            Path(file).unlink(missing_ok=True)
    shutil.rmtree(build, ignore_errors=True)
