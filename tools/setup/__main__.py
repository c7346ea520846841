"""Set the project up; `make setup` runs this with the interpreter that `tools/setup.sh` found."""

from __future__ import annotations

import argparse
import fcntl
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tools.setup.checks import check_libraries
from tools.setup.environment import (
    INTERPRETER,
    OAISYS_MSGS,
    PYTHON_PACKAGES,
    REPOSITORY,
    REQUIREMENTS,
    SETUP,
    UNDERLAY,
    Environment,
    process_environment,
)
from tools.setup.packages import (
    THREE_VERSION,
    build_interfaces,
    check_machine,
    install_packages,
    install_requirements,
    install_three,
)
from tools.setup.steps import SetupError, SetupStep, digest, run_steps

_PROJECT_FILES = ("pyproject.toml", "setup.py", "setup.cfg", "package.xml")


def _steps(environment: Environment) -> list[SetupStep]:
    requirements = digest(REQUIREMENTS, SETUP, INTERPRETER, str(environment.root))
    interfaces = digest(requirements, OAISYS_MSGS, *UNDERLAY)
    project = [package / name for package in PYTHON_PACKAGES for name in _PROJECT_FILES]
    packages = digest(requirements, *(file for file in project if file.is_file()))
    return [
        SetupStep(
            "requirements",
            "installing the pinned packages (3 GB, 1 to 3 minutes)",
            requirements,
            lambda done_before: install_requirements(environment, keep=done_before),
            lambda done_before: check_machine(environment, keep=done_before),
        ),
        SetupStep(
            "interfaces",
            "building the ROS interfaces (1 to 2 minutes)",
            interfaces,
            lambda _: build_interfaces(environment),
        ),
        SetupStep(
            "libraries",
            "checking that everything loads",
            interfaces,
            lambda _: check_libraries(environment),
        ),
        SetupStep(
            "packages",
            "installing the project's packages",
            packages,
            lambda _: install_packages(environment),
        ),
        SetupStep(
            "three",
            "fetching three.js for reports",
            digest(requirements, THREE_VERSION),
            lambda _: install_three(environment),
        ),
    ]


def _generate_protos(environment: Environment) -> None:
    script = REPOSITORY / "oaisys_grpc" / "generate_protos.py"
    variables = process_environment(environment)
    if subprocess.run([environment.python, script], env=variables, check=False).returncode:
        raise SetupError("generating the gRPC code failed")


@contextmanager
def _alone(environment: Environment) -> Iterator[None]:
    """Hold the lock of the environment, so that two `make` runs do not install at once."""
    environment.root.parent.mkdir(parents=True, exist_ok=True)
    with environment.root.with_name(f"{environment.root.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def main() -> int:
    """Run the steps that are not done yet; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.setup", description=__doc__)
    parser.add_argument("--venv", type=Path, default=Path(".venv"))
    environment = Environment(parser.parse_args().venv.absolute())
    try:
        with _alone(environment):
            run_steps(_steps(environment), environment.state / "stamps")
            _generate_protos(environment)
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("setup: interrupted; run it again", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
