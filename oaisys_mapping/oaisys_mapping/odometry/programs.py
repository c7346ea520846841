"""Runs programs that are installed beside this Python, or on the path."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from oaisys_core.errors import OaisysError
from oaisys_core.system.ending.owner import command_with_owner
from oaisys_core.system.program_output import printable_lines
from oaisys_core.system.python_programs import python_environment

TIMEOUT_S = 1800.0
"""For one program; KISS-ICP takes a tenth of that for 200 s of lidar."""


class ProgramError(OaisysError):
    """A program failed or took too long; the message ends with its last lines."""


def program(name: str) -> Path | None:
    """Return the path of a program; None if it is not installed."""
    beside = Path(sys.executable).with_name(name)
    if beside.is_file():
        return beside
    found = shutil.which(name)
    return None if found is None else Path(found)


@contextmanager
def program_folder() -> Iterator[Path]:
    """Yield a temporary folder for the files of programs.

    Raises:
        ProgramError: It cannot be made or written to, as on a full disk.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            yield Path(folder)
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        text = f"its temporary files could not be written ({error.strerror or error}{where})"
        raise ProgramError(text) from error


def run_program(
    command: Sequence[str | Path], home: Path, variables: Mapping[str, str] | None = None
) -> str:
    """Run a program and return its standard output.

    Args:
        command: Program and arguments.
        home: Its working folder, and where it may keep settings.
        variables: Additional environment variables.

    Raises:
        ProgramError: It failed, or took longer than `TIMEOUT_S`.
    """
    environment = {
        **python_environment(),
        "HOME": str(home),
        "MPLBACKEND": "agg",
        **(variables or {}),
    }
    name = Path(command[0]).name
    try:
        done = subprocess.run(
            command_with_owner([str(part) for part in command]),
            cwd=home,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise ProgramError(f"{name}: no end after {TIMEOUT_S:g} s") from error
    if done.returncode:
        lines = printable_lines((done.stderr or done.stdout).strip())[-3:]
        raise ProgramError(f"{name} ended with exit code {done.returncode}: {' | '.join(lines)}")
    return done.stdout
