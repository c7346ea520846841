"""Runs long programs with a log file and progress messages for the user."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

LINE_EVERY_S = 5.0


def run_with_progress(
    command: Sequence[str | Path],
    variables: Mapping[str, str],
    log: Path,
    progress: Callable[[str], str],
    every_s: float = LINE_EVERY_S,
) -> int:
    """Run a program and print a line of progress every few seconds.

    Args:
        command: The program and its arguments.
        variables: Its environment variables.
        log: File for its output.
        progress: Returns a description of the progress, given the output so far.
        every_s: Seconds between two lines.

    Returns:
        Its exit code.
    """
    started_s = time.monotonic()
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w") as output:
        process = subprocess.Popen(command, env=dict(variables), stdout=output, stderr=output)
    try:
        while True:
            try:
                return process.wait(every_s)
            except subprocess.TimeoutExpired:
                elapsed_s = time.monotonic() - started_s
                said = progress(log.read_text(errors="replace"))
                print(f"setup:   {said}, {elapsed_s:.0f} s", file=sys.stderr, flush=True)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def pip_progress(output: str, wanted: int, site_packages: Path) -> str:
    """Return the progress of pip, from its output and the installed packages."""
    lines = output.splitlines()
    if any(line.startswith("Installing collected packages") for line in lines):
        installed = sum(1 for _ in site_packages.glob("*.dist-info"))  # pip itself among them
        return f"{min(installed, wanted)} of {wanted} packages installed"
    starts = ("Collecting ", "Requirement already satisfied", "Obtaining ")
    collected = sum(line.startswith(starts) for line in lines)
    return f"{min(collected, wanted)} of {wanted} packages collected"


def colcon_progress(output: str, wanted: int, build: Path) -> str:
    """Return the progress of colcon, from its output and the compiled files."""
    finished = output.count("Finished <<<")
    objects = sum(1 for _ in build.rglob("*.o"))
    return f"{finished} of {wanted} packages built, {objects} files compiled"
