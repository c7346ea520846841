"""Runs each job in a process of its own, with its own memory peak, caches and Blender.

``python -m tools.bench.child MODULE FUNCTION`` reads settings and arguments as JSON from standard
input and writes lines of JSON: what it does, then what it measured.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from oaisys_core.errors import OaisysError
from oaisys_core.system.ending.owner import follow_owner
from oaisys_core.system.program_output import last_lines
from oaisys_core.system.python_programs import python_command
from tools.bench.settings import Say, Settings
from tools.programs import ROOT, tool_environment

TIMEOUT_S = 3600.0
"""For a job; references take the longest, five minutes per view."""
PATIENCE_S = 30.0
"""For a job to clean up after it is done or was told to stop."""
LOG_LINES = 12
CORE = "oaisys_core"
"""Folder of the package that jobs measure, in the root of a checkout."""


class JobError(OaisysError):
    """A job failed or took too long; the message ends with its log."""


def run_job(
    job: str,
    settings: Settings,
    say: Say,
    *,
    timeout_s: float = TIMEOUT_S,
    core_of: Path | None = None,
    cores: Collection[int] = (),
    **arguments: Any,
) -> Any:
    """Return what a job returns.

    Args:
        job: ``module.function`` below `tools.bench.jobs`; called with ``settings``, ``say`` and
            the arguments. Arguments and result are JSON-able.
        settings: Of the run.
        say: Called with the progress.
        timeout_s: After it, the job is stopped.
        core_of: Root of another checkout, to use its `oaisys_core` instead of this one's.
        cores: Cores that the job's process may use; none: all.
        arguments: Keyword arguments of the job.

    Raises:
        JobError: It failed.
    """
    module, _, function = job.rpartition(".")
    log = settings.out / "logs" / f"{job}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    command = python_command("tools.bench.child", f"tools.bench.jobs.{module}", function)
    process = _start(command, log, core_of, cores)
    try:
        result = _result(process, {"settings": settings.to_dict(), **arguments}, say, timeout_s)
        process.wait(PATIENCE_S)
    except (EOFError, subprocess.TimeoutExpired) as error:
        raise JobError(f"{job}: {error}{_end_of(log)}") from error
    finally:
        _end(process)
    return result


def _start(
    command: Sequence[str], log: Path, core_of: Path | None, cores: Collection[int]
) -> subprocess.Popen[bytes]:
    # Found before the installed package, which is this checkout's; the tools stay this one's.
    first = () if core_of is None else (core_of / CORE,)
    with log.open("wb") as output, pin(cores):
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=output,
            cwd=ROOT,
            env=tool_environment(*first),
            start_new_session=True,
        )


@contextlib.contextmanager
def pin(cores: Collection[int]) -> Iterator[None]:
    """Restrict this thread to cores for as long as the context lasts; none: to no fewer.

    A process that it starts inherits that, so no library of the process sees other cores.
    """
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores or before)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _result(
    process: subprocess.Popen[bytes], arguments: dict[str, Any], say: Say, timeout_s: float
) -> Any:
    """Return the job's result; `EOFError` where it ends without one."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(arguments).encode())
    process.stdin.close()
    end_s = time.monotonic() + timeout_s
    pending = b""
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while (left_s := end_s - time.monotonic()) > 0:
            if not selector.select(left_s):
                break
            chunk = os.read(process.stdout.fileno(), 1 << 20)
            if not chunk:
                raise EOFError(f"ended with exit code {process.wait(PATIENCE_S)}")
            *lines, pending = (pending + chunk).split(b"\n")
            for message in map(json.loads, lines):
                if "result" in message:
                    return message["result"]
                say(message["share"], message["text"])
    raise EOFError(f"no result after {timeout_s:g} s")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Interrupt the job if it still runs, then kill its process group."""
    try:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE_S)
    finally:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def _end_of(log: Path) -> str:
    lines = [line for line in last_lines(log) if not line.startswith("Fra:")]
    return "".join(f"\n  | {line}" for line in lines[-LOG_LINES:])


def main() -> None:
    """Run one job and write its result to what was standard output."""
    follow_owner()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("module")
    parser.add_argument("function")
    options = parser.parse_args()
    ours = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)  # what libraries print goes to the log
    # A shell makes processes in the background ignore SIGINT.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def say(share: float, text: str) -> None:
        ours.write(json.dumps({"share": share, "text": text}) + "\n")

    arguments = json.load(sys.stdin)
    settings = Settings.from_dict(arguments.pop("settings"))
    job = getattr(importlib.import_module(options.module), options.function)
    result = job(settings, say, **arguments)
    ours.write(json.dumps({"result": result}) + "\n")
    ours.close()


if __name__ == "__main__":
    main()
