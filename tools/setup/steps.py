"""Steps of the set-up: they run once, and again when their inputs have changed."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

LINE_EVERY_S = 5.0


class SetupError(Exception):
    """The set-up cannot continue; the message is the line that the user sees."""


class OptionalStepError(SetupError):
    """An optional step failed; the next set-up tries it again."""


@dataclass(frozen=True)
class SetupStep:
    """A step of the set-up.

    Attributes:
        name: Name of its stamp file.
        does: Description for the user while it runs.
        key: Hash of everything the result depends on.
        run: Does the work; its argument is whether it was completed before. Raises `SetupError`, or
            `OptionalStepError` if the step is optional.
        check: Raises `SetupError` if the work cannot succeed, before anything is done.
    """

    name: str
    does: str
    key: str
    run: Callable[[bool], None]
    check: Callable[[bool], None] = lambda _: None


def digest(*parts: str | Path) -> str:
    """Hash strings and the contents of files; folders include all files below them."""
    state = hashlib.sha256()
    for part in parts:
        if isinstance(part, str):
            state.update(f"text {part}\n".encode())
            continue
        for file in _files(part):
            state.update(f"file {file.relative_to(part.parent)}\n".encode())
            state.update(hashlib.sha256(file.read_bytes()).digest())
    return state.hexdigest()


def _files(path: Path) -> Iterable[Path]:
    if path.is_file():
        return [path]
    files = (file for file in path.rglob("*") if file.is_file())
    return sorted(file for file in files if file.parent.name != "__pycache__")


def run_steps(steps: Sequence[SetupStep], stamps: Path) -> None:
    """Run the steps whose key differs from their stamp, in order.

    The stamp is written last, so that an interrupted step runs again at the next set-up.
    """
    for step in steps:
        stamp = stamps / step.name
        old_key = stamp.read_text() if stamp.is_file() else None
        if old_key == step.key:
            continue
        step.check(old_key is not None)
        print(f"setup: {step.does} ...", file=sys.stderr, flush=True)
        stamp.unlink(missing_ok=True)
        started_s = time.monotonic()
        try:
            step.run(old_key is not None)
        except OptionalStepError as error:
            print(f"setup: left out: {error}", file=sys.stderr, flush=True)
            continue
        stamps.mkdir(parents=True, exist_ok=True)
        stamp.write_text(step.key)
        elapsed_s = time.monotonic() - started_s
        print(f"setup: {step.does}: done in {elapsed_s:.0f} s", file=sys.stderr, flush=True)


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
