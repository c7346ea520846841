"""All that a program of others has started ends with it, also in sessions of its own.

Run as a program, ``python descendants.py OWNER COMMAND...``, this file starts a command and waits
for it. At the end of the command, or of its owner, it kills what is left of all that the command
has started: orphans become its own children. SIGTERM ends them all at once; SIGINT, SIGHUP,
SIGQUIT and SIGABRT go to the command. It imports nothing of ours, so that this takes no time.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_PASSED_ON = frozenset({signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT})
_WAITED_FOR = _PASSED_ON | {signal.SIGTERM, signal.SIGCHLD}


def command_with_descendants(command: Sequence[str]) -> list[str]:
    """Return the command for another's program that ends with all that it has started.

    It exits as the program does. If this process dies, all of them are killed.
    """
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), *command]


def kill_descendants() -> None:
    """Kill the children of this process, and theirs, which become its own as their parents die.

    Holds where orphans become its own, see `adopt_orphans`.
    """
    while children := list(_children()):
        for child in children:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(-1, 0)


def adopt_orphans(*, wanted: bool = True) -> None:
    """Have what this process's descendants leave behind become its children."""
    _prctl(_PR_SET_CHILD_SUBREAPER, int(wanted))


def end_with_parent(number: int) -> None:
    """Have the kernel send this process a signal when its parent ends, also after `os.execvp`."""
    _prctl(_PR_SET_PDEATHSIG, number)


def _children() -> Iterator[int]:
    """Yield the ids of the children of this process."""
    own = str(os.getpid()).encode()
    for entry in os.scandir("/proc"):
        if entry.name.isdecimal():
            with suppress(OSError):
                # The name before state and parent may have blanks and parentheses.
                rest = Path(entry.path, "stat").read_bytes().rpartition(b")")[2].split()
                if rest[1] == own:
                    yield int(entry.name)


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0)


def _run(owner: str, *command: str) -> NoReturn:
    """Run a command, kill what it leaves, and exit as it does."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _WAITED_FOR)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    adopt_orphans()
    end_with_parent(signal.SIGTERM)
    own = os.getpid()
    if os.getppid() != int(owner):  # it died meanwhile
        os._exit(128 + signal.SIGTERM)
    child = os.fork()
    if not child:
        # A group of its own: what it sends to its group must not reach this process.
        os.setpgid(0, 0)
        end_with_parent(signal.SIGKILL)
        if os.getppid() != own:
            os._exit(128 + signal.SIGKILL)
        for number in (signal.SIGPIPE, signal.SIGXFSZ):  # which Python ignores
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        _become(command)
    os.closerange(3, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    status = _wait(child)
    kill_descendants()
    if status is None:
        os._exit(128 + signal.SIGTERM)
    if os.WIFSIGNALED(status):
        _end_by(os.WTERMSIG(status))
    os._exit(os.WEXITSTATUS(status))


def _wait(child: int) -> int | None:
    """Return the status of a child that has ended; None: it is to be killed."""
    while True:
        number = signal.sigwait(_WAITED_FOR)
        if number == signal.SIGTERM:
            return None
        if number in _PASSED_ON:
            with suppress(ProcessLookupError):
                os.kill(child, number)
            continue
        ended = 1
        while ended:  # one SIGCHLD may stand for many
            ended, status = os.waitpid(-1, os.WNOHANG)
            if ended == child:
                return status


def _become(command: tuple[str, ...]) -> NoReturn:
    """Replace this process by a program."""
    try:
        os.execvp(command[0], command)  # noqa: S606 - the caller's command
    except OSError as error:
        sys.stderr.write(f"{command[0]}: {error.strerror}\n")
        sys.stderr.flush()
        os._exit(127)


def _end_by(number: int) -> NoReturn:
    """End this process by a signal, without a core file."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):  # SIGKILL has no handler
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {number})
    os.kill(os.getpid(), number)
    os._exit(128 + number)


if __name__ == "__main__":
    _run(*sys.argv[1:])
