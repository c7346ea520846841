"""Steps of the set-up: they run once, and again when their inputs have changed."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

from tools.setup.errors import OptionalStepError
from tools.setup.programs import Programs


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


def run_stages(stages: Sequence[Sequence[SetupStep]], stamps: Path, programs: Programs) -> bool:
    """Run the steps whose key differs from their stamp: stages in order, a stage's steps at once.

    A stamp is written last, so that an interrupted step runs again at the next set-up.

    Returns:
        Whether there was anything to do.

    Raises:
        SetupError: A step failed; the other steps of its stage were ended.
    """
    worked = False
    for number, stage in enumerate(stages, start=1):
        due = [step for step in stage if _old_key(step, stamps) != step.key]
        for step in due:
            step.check(_old_key(step, stamps) is not None)
        if not due:
            continue
        worked = True
        with ThreadPoolExecutor(len(due)) as pool:
            try:
                for step in due:
                    programs.display.say(f"{number} of {len(stages)}: {step.does} ...")
                running = [pool.submit(_run, step, stamps, programs) for step in due]
                finished, _ = wait(running, return_when=FIRST_EXCEPTION)
                for future in finished:
                    future.result()
            except BaseException:
                programs.stop()
                raise
    return worked


def _old_key(step: SetupStep, stamps: Path) -> str | None:
    stamp = stamps / step.name
    return stamp.read_text() if stamp.is_file() else None


def _run(step: SetupStep, stamps: Path, programs: Programs) -> None:
    done_before = _old_key(step, stamps) is not None
    stamp = stamps / step.name
    stamp.unlink(missing_ok=True)
    started_s = time.monotonic()
    try:
        step.run(done_before)
    except OptionalStepError as error:
        programs.display.say(f"left out: {error}")
        return
    stamps.mkdir(parents=True, exist_ok=True)
    stamp.write_text(step.key)
    programs.display.say(f"{step.does}: done in {time.monotonic() - started_s:.0f} s")
