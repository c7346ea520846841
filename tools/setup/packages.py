"""The virtual environment and the Python packages in it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

from tools.setup.checks import check_compiler, check_disk
from tools.setup.errors import SetupError
from tools.setup.paths import INTERPRETER, PYTHON_PACKAGES, REQUIREMENTS, Environment
from tools.setup.relocation import relocate
from tools.setup.variables import process_environment, write_script


def install_requirements(environment: Environment, *, keep: bool) -> None:
    """Install the pinned packages and make the ROS wheels point here.

    Args:
        environment: The environment to fill.
        keep: Add to a completed environment instead of starting from an empty one.

    Raises:
        SetupError: There is no compiler or too little disk space, or pip failed.
    """
    check_compiler()
    made_with = environment.state / "interpreter"
    if not (keep and made_with.is_file() and made_with.read_text() == INTERPRETER):
        _create(environment)
        made_with.write_text(INTERPRETER)
    _pip(environment, "--requirement", str(REQUIREMENTS))
    _lend_libusb(environment)
    include, numpy_include = _include_folders(environment)
    relocate(environment.root, include, numpy_include)
    write_script(environment)


def install_packages(environment: Environment) -> None:
    """Install the project's own packages so that edits take effect without installing again."""
    editable = [part for package in PYTHON_PACKAGES for part in ("--editable", str(package))]
    _pip(environment, "--no-build-isolation", *editable)


def _create(environment: Environment) -> None:
    root = environment.root
    if root.exists():
        if any(root.iterdir()) and not (root / "pyvenv.cfg").is_file():
            raise SetupError(f"{root} exists and is no virtual environment: choose another VENV")
        shutil.rmtree(root)
    check_disk(root)
    venv.create(root, with_pip=True)
    environment.state.mkdir()


def _pip(environment: Environment, *arguments: str) -> None:
    # Some machines keep /tmp in memory: the wheels are unpacked on the environment's own disk.
    temporary = environment.state / "tmp"
    temporary.mkdir(parents=True, exist_ok=True)
    command = [str(environment.python), "-m", "pip", "install", "--no-deps", "--no-input"]
    command += ["--quiet", "--disable-pip-version-check", "--no-warn-script-location", *arguments]
    variables = process_environment(environment) | {"TMPDIR": str(temporary)}
    # pip complains once per package about every index it was configured with and cannot reach.
    log = environment.state / "pip.log"
    with log.open("w") as output:
        result = subprocess.run(command, env=variables, stdout=output, stderr=output, check=False)
    shutil.rmtree(temporary, ignore_errors=True)
    if result.returncode:
        errors = [line for line in log.read_text().splitlines() if not line.startswith("WARNING")]
        sys.stderr.write(os.linesep.join(errors[-40:]) + os.linesep)
        raise SetupError(f"pip failed; its whole output is in {log}")


def _lend_libusb(environment: Environment) -> None:
    """Put the wheel's libusb where Open3D looks first: its own wheel counts on the system's."""
    link = environment.site_packages / "open3d" / "libusb-1.0.so.0"
    link.unlink(missing_ok=True)
    link.symlink_to(Path("..", "libusb_package", "libusb-1.0.so"))


def _include_folders(environment: Environment) -> tuple[Path, Path]:
    code = (
        "import numpy, sysconfig; print(sysconfig.get_path('include')); print(numpy.get_include())"
    )
    result = subprocess.run(
        [environment.python, "-c", code],
        env=process_environment(environment),
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise SetupError(f"numpy cannot be imported: {result.stderr.strip().splitlines()[-1]}")
    python_include, numpy_include = result.stdout.split()
    return Path(python_include), Path(numpy_include)
