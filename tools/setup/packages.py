"""Python packages: the virtual environment, the pinned wheels, and the project's own packages."""

from __future__ import annotations

import re
import shutil
import subprocess
import venv
from collections.abc import Callable
from pathlib import Path

from tools.setup.checks import NEEDED_DISK_GB, check_compiler, check_disk, folder_gb
from tools.setup.environment import (
    INTERPRETER,
    PYTHON_PACKAGES,
    REQUIREMENTS,
    Environment,
    process_environment,
    write_script,
)
from tools.setup.errors import SetupError
from tools.setup.installers import CACHE_GB, Installer, uv_cache
from tools.setup.programs import Programs
from tools.setup.relocation import relocate


def check_machine(environment: Environment, *, keep: bool) -> None:
    """Raise `SetupError` if `install_requirements` cannot succeed."""
    root = environment.root
    check_compiler()
    if _is_kept(environment, keep=keep):
        return
    if root.exists() and any(root.iterdir()) and not (root / "pyvenv.cfg").is_file():
        raise SetupError(f"{root} exists and is no virtual environment: choose another VENV")
    check_disk(root, NEEDED_DISK_GB, lambda: _gb_on_disk(root))


def _gb_on_disk(root: Path) -> float:
    """Return how much of what is needed an earlier set-up has put on the disk already."""
    cache = uv_cache(root, NEEDED_DISK_GB)
    cached_gb = folder_gb(cache.folder) if cache is not None and cache.linked else 0.0
    return folder_gb(root) + min(cached_gb, CACHE_GB)


def install_requirements(environment: Environment, programs: Programs, *, keep: bool) -> None:
    """Install the pinned packages and fix the paths in the ROS wheels.

    Args:
        environment: The environment to fill.
        programs: Run the installers.
        keep: Whether to keep a completed environment instead of starting from an empty one.

    Raises:
        SetupError: uv and pip failed.
    """
    kept = _is_kept(environment, keep=keep)
    if not kept:
        _create(environment)
    installer = Installer(environment, programs, uv_cache(environment.root, NEEDED_DISK_GB))
    # What uv left half done would be in pip's way.
    renew = (lambda: None) if kept else (lambda: _create(environment))
    install_pinned(installer, REQUIREMENTS, renew)
    _lend_libusb(environment)
    relocate(environment.root, *_include_folders(environment))
    write_script(environment)


def install_pinned(installer: Installer, requirements: Path, renew: Callable[[], None]) -> None:
    """Install a list of pinned packages, one of which is uv.

    Args:
        installer: Of an environment with pip.
        requirements: The list.
        renew: Empties the environment, if uv has failed.

    Raises:
        SetupError: uv and pip failed.
    """
    pinned = _versions_by_package(requirements)
    if installer.bring_uv(pinned["uv"]) and installer.with_uv(
        len(pinned), "--requirement", str(requirements)
    ):
        return
    said = installer.uv_log.read_text(errors="replace")
    renew()
    installer.uv_log.write_text(said)
    del pinned["uv"]
    rest = installer.environment.state / "requirements.txt"
    rest.write_text("".join(f"{name}=={version}\n" for name, version in pinned.items()))
    installer.with_pip(len(pinned), "--requirement", str(rest))


def _versions_by_package(requirements: Path) -> dict[str, str]:
    """Return the versions in a requirements file, by package."""
    return dict(re.findall(r"^([\w.-]+)==(\S+)$", requirements.read_text(), re.MULTILINE))


def _create(environment: Environment) -> None:
    """Make an empty environment with pip."""
    shutil.rmtree(environment.root, ignore_errors=True)
    venv.create(environment.root, with_pip=True)
    environment.state.mkdir()
    _interpreter_note(environment).write_text(INTERPRETER)


def _is_kept(environment: Environment, *, keep: bool) -> bool:
    note = _interpreter_note(environment)
    return keep and note.is_file() and note.read_text() == INTERPRETER


def _interpreter_note(environment: Environment) -> Path:
    return environment.state / "interpreter"


def install_packages(environment: Environment, programs: Programs) -> None:
    """Install the project's own packages in editable mode.

    Raises:
        SetupError: uv and pip failed.
    """
    installer = Installer(environment, programs, uv_cache(environment.root, 0.0))
    # Use paths instead of import hooks: in the repository's root, folders would hide the packages.
    arguments = ["--no-build-isolation", "--config-settings", "editable_mode=compat"]
    for package in PYTHON_PACKAGES:
        arguments += ["--editable", str(package)]
    if not installer.uv.is_file() or not installer.with_uv(len(PYTHON_PACKAGES), *arguments):
        installer.with_pip(len(PYTHON_PACKAGES), *arguments)


def _lend_libusb(environment: Environment) -> None:
    """Link the libusb wheel where Open3D looks first, because Open3D expects the system's."""
    link = environment.site_packages / "open3d" / "libusb-1.0.so.0"
    link.unlink(missing_ok=True)
    link.symlink_to(Path("..", "libusb_package", "libusb-1.0.so"))


def _include_folders(environment: Environment) -> tuple[Path, Path]:
    code = (
        "import numpy, sysconfig; print(sysconfig.get_path('include')); print(numpy.get_include())"
    )
    result = subprocess.run(
        [environment.python, "-P", "-c", code],
        env=process_environment(environment),
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise SetupError(f"numpy cannot be imported: {result.stderr.strip().splitlines()[-1]}")
    python_include, numpy_include = result.stdout.split()
    return Path(python_include), Path(numpy_include)
