"""Set the project up; `make setup` runs this with the interpreter that `tools/setup.sh` found."""

from __future__ import annotations

import argparse
import fcntl
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from tools.setup.checks import check_libraries
from tools.setup.environment import (
    INTERPRETER,
    OAISYS_MSGS,
    PYTHON_PACKAGES,
    REPOSITORY,
    REQUIREMENTS,
    SETUP,
    UNDERLAY,
    VERSION,
    Environment,
    process_environment,
)
from tools.setup.errors import SetupError
from tools.setup.interfaces import install_interfaces
from tools.setup.packages import check_machine, install_packages, install_requirements
from tools.setup.programs import Display, Programs
from tools.setup.steps import SetupStep, digest, run_stages
from tools.setup.three import THREE_VERSION, install_three

_ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_PROJECT_FILES = ("pyproject.toml", "setup.py", "setup.cfg", "package.xml")
_COMPILED = "oaisys_*/private/*.c"
"""In each package, what its ``setup.py`` compiles."""


def _stages(environment: Environment, programs: Programs) -> list[list[SetupStep]]:
    """Return the steps; those of one stage run at the same time."""
    requirements = digest(REQUIREMENTS, SETUP, INTERPRETER, str(environment.root))
    interfaces = digest(requirements, OAISYS_MSGS, *UNDERLAY)
    project = [package / name for package in PYTHON_PACKAGES for name in _PROJECT_FILES]
    compiled = [file for package in PYTHON_PACKAGES for file in sorted(package.glob(_COMPILED))]
    found = [file for file in project if file.is_file()]
    packages = digest(requirements, VERSION, *found, *compiled)
    install = SetupStep(
        "requirements",
        "installing the pinned packages (4 GB)",
        requirements,
        lambda done_before: install_requirements(environment, programs, keep=done_before),
        lambda done_before: check_machine(environment, keep=done_before),
    )
    build = SetupStep(
        "interfaces",
        "installing the ROS interfaces",
        interfaces,
        lambda _: install_interfaces(environment, programs),
    )
    fetch_three = SetupStep(
        "three",
        "fetching three.js for reports",
        digest(requirements, THREE_VERSION),
        lambda _: install_three(environment, programs),
    )
    check = SetupStep(
        "libraries",
        "checking that everything loads",
        interfaces,
        lambda _: check_libraries(environment),
    )
    install_project = SetupStep(
        "packages",
        "installing the project's packages",
        packages,
        lambda _: install_packages(environment, programs),
    )
    return [[install], [build, fetch_three], [check, install_project]]


def _generate_protos(environment: Environment) -> None:
    script = REPOSITORY / "oaisys_grpc" / "generate_protos.py"
    variables = process_environment(environment)
    if subprocess.run([environment.python, script], env=variables, check=False).returncode:
        raise SetupError("generating the gRPC code failed")


@contextmanager
def _alone(environment: Environment) -> Iterator[None]:
    """Hold the lock of the environment, so that two `make` runs do not install at once."""
    environment.root.parent.mkdir(parents=True, exist_ok=True)
    path = environment.root.with_name(f"{environment.root.name}.lock")
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise SetupError(f"{path} cannot be locked: {error.strerror}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _interrupt_once(_number: int, _frame: FrameType | None) -> None:
    """Raise `KeyboardInterrupt`; further signals must not interrupt the ending of what runs."""
    for ending in _ENDINGS:
        signal.signal(ending, signal.SIG_IGN)
    raise KeyboardInterrupt


def main() -> int:
    """Run the steps that are not done yet; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.setup", description=__doc__)
    parser.add_argument("--venv", type=Path, default=Path(".venv"))
    environment = Environment(parser.parse_args().venv.absolute())
    for ending in _ENDINGS:
        if signal.getsignal(ending) is not signal.SIG_IGN:
            signal.signal(ending, _interrupt_once)
    display = Display()
    programs = Programs(display)
    started_s = time.monotonic()
    try:
        with _alone(environment):
            stages = _stages(environment, programs)
            worked = run_stages(stages, environment.state / "stamps", programs)
            _generate_protos(environment)
    except SetupError as error:
        display.say(str(error))
        return 1
    except KeyboardInterrupt:
        display.say("interrupted; run it again")
        return 130
    if worked:
        display.say(f"done, {time.monotonic() - started_s:.0f} s altogether")
    return 0


if __name__ == "__main__":
    sys.exit(main())
