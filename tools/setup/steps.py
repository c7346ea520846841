"""Set-up steps that run once, and again when their inputs have changed."""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools.setup.errors import OptionalStepError


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
