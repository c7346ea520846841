"""What is installed: wheels, our own packages, ROS interfaces that no wheel contains, three.js."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

from tools.setup.checks import NEEDED_DISK_GB, check_compiler, check_disk
from tools.setup.environment import (
    INTERPRETER,
    OAISYS_MSGS,
    PYTHON_PACKAGES,
    REQUIREMENTS,
    UNDERLAY,
    Environment,
    process_environment,
    write_script,
)
from tools.setup.steps import (
    OptionalStepError,
    SetupError,
    colcon_progress,
    pip_progress,
    run_with_progress,
)

THREE_VERSION = "0.183.2"
"""The last version with minified modules."""

NPM_TIMEOUT_S = 120.0

_BUILD_PREFIX = rb"/opt/python/cp\d+-cp\d+"
_PYTHON_INCLUDE = re.compile(_BUILD_PREFIX + rb"/include/python3\.\d+")
_NUMPY_INCLUDE = re.compile(
    _BUILD_PREFIX + rb"/lib/python3\.\d+/site-packages/numpy/_?core/include"
)
_PREFIX = re.compile(_BUILD_PREFIX)


def check_machine(environment: Environment, *, keep: bool) -> None:
    """Raise `SetupError` if `install_requirements` cannot succeed."""
    root = environment.root
    check_compiler()
    if _is_kept(environment, keep=keep):
        return
    if root.exists() and any(root.iterdir()) and not (root / "pyvenv.cfg").is_file():
        raise SetupError(f"{root} exists and is no virtual environment: choose another VENV")
    reclaimed_gb = sum(file.lstat().st_size for file in root.rglob("*")) / 1e9
    check_disk(root, NEEDED_DISK_GB - reclaimed_gb)


def install_requirements(environment: Environment, *, keep: bool) -> None:
    """Install the pinned packages and fix the paths in the ROS wheels.

    Args:
        environment: The environment to fill.
        keep: Whether to keep a completed environment instead of starting from an empty one.

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
    """Install the project's own packages in editable mode."""
    # Use paths instead of import hooks: in the repository's root, folders would hide the packages.
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
    # /tmp may be in memory, so unpack the wheels on the disk of the environment.
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
        # Omit lines about collected packages and unreachable indices.
        usual = ("WARNING", "Collecting", "Requirement already", "  Using cached", "  Downloading")
        errors = [line for line in log.read_text().splitlines() if not line.startswith(usual)]
        sys.stderr.write(os.linesep.join(errors[-40:]) + os.linesep)
        raise SetupError(f"pip failed; its whole output is in {log}")


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


def relocate(prefix: Path, python_include: Path, numpy_include: Path) -> int:
    """Replace the build machine's paths in every text file under ``prefix/share``.

    A second call changes nothing.

    Args:
        prefix: The virtual environment.
        python_include: The folder with the interpreter's ``Python.h``.
        numpy_include: The folder of numpy's headers.

    Returns:
        The number of files that were rewritten.
    """
    replacements = (
        (_PYTHON_INCLUDE, _literal(python_include)),
        (_NUMPY_INCLUDE, _literal(numpy_include)),
        (_PREFIX, _literal(prefix)),
    )
    rewritten = 0
    for file in sorted((prefix / "share").rglob("*")):
        if not file.is_file() or file.is_symlink():
            continue
        old = file.read_bytes()
        if b"\0" in old or not _PREFIX.search(old):
            continue
        new = old
        for pattern, path in replacements:
            new = pattern.sub(path, new)
        file.write_bytes(new)
        rewritten += 1
    return rewritten


def _literal(path: Path) -> bytes:
    """Return ``path`` as a literal replacement text."""
    return bytes(path).replace(b"\\", rb"\\")


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


def install_three(environment: Environment) -> None:
    """Install three.js to ``share/oaisys_mapping``, where reports find it.

    Raises:
        OptionalStepError: npm is missing or failed; reports then show pictures of the mesh.
    """
    without = "reports will show pictures of the mesh instead of an interactive view"
    npm = shutil.which("npm")
    if npm is None:
        raise OptionalStepError(f"three.js needs npm, and there is none: {without}")
    folder = environment.root / "share" / "oaisys_mapping"
    folder.mkdir(parents=True, exist_ok=True)
    # Do not retry failed downloads for minutes.
    command = [npm, "install", "--prefix", str(folder), "--no-save", "--no-package-lock"]
    command += ["--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=1"]
    command.append(f"three@{THREE_VERSION}")
    log = environment.state / "npm.log"
    with log.open("w") as output:
        try:
            result = subprocess.run(
                command, stdout=output, stderr=output, timeout=NPM_TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            raise OptionalStepError(f"npm took more than {NPM_TIMEOUT_S:g} s: {without}") from None
    if result.returncode:
        raise OptionalStepError(f"npm failed, its output is in {log}: {without}")
