"""Ends what a killed driver leaves of its embedded Ray, and removes Ray's temporary folder.

Ray's daemons notice the death of a driver only after a minute or more, and nobody removes their
folder. The driver starts this program with the folder and a mark as arguments, and a pipe as
standard input, which ends when the driver ends, in whatever way. It imports nothing but the
standard library, so that it costs a few megabytes.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

MARK = "OAISYS_RAY_SESSION"
"""Environment variable that all processes of a session have, with the folder as its value."""

PATIENCE_S = 10.0
"""How long the guard tries to end processes and to empty the folder."""

_PAUSE_S = 0.1


def guard(folder: Path) -> None:
    """Wait for the end of standard input, then end the session's processes; remove its folder."""
    # Ctrl-C and the end of a terminal, or of a service, reach all its processes; the guard waits
    # for the driver, and then ends the others.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):
        while sys.stdin.buffer.read(1):
            pass
    clear(folder)


def clear(folder: Path) -> None:
    """Kill the processes of a session until none is left, and remove its folder."""
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        left = list(_processes_of_session(folder))
        for process_id in left:
            with suppress(ProcessLookupError):
                os.kill(process_id, signal.SIGKILL)
        if not left:
            # Only now does nobody write to the folder any more.
            shutil.rmtree(folder, ignore_errors=True)
        if (not left and not folder.exists()) or time.monotonic() > deadline_s:
            return
        time.sleep(_PAUSE_S)


def _processes_of_session(folder: Path) -> Iterator[int]:
    """Yield the ids of the running processes of a session, but for this one and its driver."""
    wanted = f"{MARK}={folder}".encode()
    for entry in os.scandir("/proc"):
        if not entry.name.isdecimal() or int(entry.name) in (os.getpid(), os.getppid()):
            continue
        with suppress(OSError):
            has_mark = wanted in Path(entry.path, "environ").read_bytes().split(b"\0")
            # Agents of Ray write their title over their environment; their logs stay open.
            if has_mark or _has_open(Path(entry.path, "fd"), f"{folder}/"):
                yield int(entry.name)


def _has_open(descriptors: Path, below: str) -> bool:
    """Return whether a process has a file open below a folder."""
    return any(str(each.readlink()).startswith(below) for each in descriptors.iterdir())


if __name__ == "__main__":
    guard(Path(sys.argv[1]))
