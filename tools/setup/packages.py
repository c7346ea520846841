"""The virtual environment and the Python packages in it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

from tools.setup.checks import NEEDED_DISK_GB, check_compiler, check_disk
from tools.setup.errors import SetupError
from tools.setup.paths import INTERPRETER, PYTHON_PACKAGES, REQUIREMENTS, Environment
from tools.setup.progress import pip_progress, run_with_progress
from tools.setup.relocation import relocate
from tools.setup.variables import process_environment, write_script


def check_machine(environment: Environment, *, keep: bool) -> None:
    """Raise `SetupError` where `install_requirements` cannot succeed."""
    root = environment.root
    check_compiler()
    if _is_kept(environment, keep=keep):
        return
    if root.exists() and any(root.iterdir()) and not (root / "pyvenv.cfg").is_file():
        raise SetupError(f"{root} exists and is no virtual environment: choose another VENV")
    reclaimed_gb = sum(file.lstat().st_size for file in root.rglob("*")) / 1e9
    check_disk(root, NEEDED_DISK_GB - reclaimed_gb)


def install_requirements(environment: Environment, *, keep: bool) -> None:
    """Install the pinned packages and make the ROS wheels point here.

    Args:
        environment: The environment to fill.
        keep: Add to a completed environment instead of starting from an empty one.

    Raises:
        SetupError: pip failed.
    """
    if not _is_kept(environment, keep=keep):
        shutil.rmtree(environment.root, ignore_errors=True)
        venv.create(environment.root, with_pip=True)
        environment.state.mkdir()
        _interpreter_note(environment).write_text(INTERPRETER)
    lines = REQUIREMENTS.read_text().splitlines()
    wanted = sum("==" in line for line in lines)
    _pip(environment, wanted, "--requirement", str(REQUIREMENTS))
    _lend_libusb(environment)
    include, numpy_include = _include_folders(environment)
    relocate(environment.root, include, numpy_include)
    write_script(environment)


def _is_kept(environment: Environment, *, keep: bool) -> bool:
    note = _interpreter_note(environment)
    return keep and note.is_file() and note.read_text() == INTERPRETER


def _interpreter_note(environment: Environment) -> Path:
    return environment.state / "interpreter"


def install_packages(environment: Environment) -> None:
    """Install the project's own packages so that edits take effect without installing again."""
    # Paths instead of import hooks: from the repository's root the folders would hide the packages.
    editable = [part for package in PYTHON_PACKAGES for part in ("--editable", str(package))]
    _pip(
        environment,
        len(PYTHON_PACKAGES),
        "--no-build-isolation",
        "--config-settings",
        "editable_mode=compat",
        *editable,
    )


def _pip(environment: Environment, wanted: int, *arguments: str) -> None:
    # Some machines keep /tmp in memory: the wheels are unpacked on the environment's own disk.
    temporary = environment.state / "tmp"
    temporary.mkdir(parents=True, exist_ok=True)
    command = [str(environment.python), "-m", "pip", "install", "--no-deps", "--no-input"]
    command += [
        "--progress-bar=off",
        "--disable-pip-version-check",
        "--no-warn-script-location",
        *arguments,
    ]
    variables = process_environment(environment) | {"TMPDIR": str(temporary)}
    log = environment.state / "pip.log"
    site_packages = environment.site_packages
    code = run_with_progress(
        command, variables, log, lambda said: pip_progress(said, wanted, site_packages)
    )
    shutil.rmtree(temporary, ignore_errors=True)
    if code:
        # pip complains once per package about every index that it cannot reach, and tells of each
        # package that it collects.
        usual = ("WARNING", "Collecting", "Requirement already", "  Using cached", "  Downloading")
        errors = [line for line in log.read_text().splitlines() if not line.startswith(usual)]
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
