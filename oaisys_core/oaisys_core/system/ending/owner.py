"""The owner of a process: the program that started it, without which it must not go on.

A program that is killed ends nothing that it has started. So it tells each program of ours who it
is, in a variable, and that program ends with it (`follow_owner`). Programs of others are started by
this file, run as a program: ``python owner.py OWNER SIGNAL COMMAND...`` becomes the command. It
imports nothing of ours, so that this takes no time.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Sequence

VARIABLE = "OAISYS_OWNER"
"""Has the owner's process id, and the number of the signal that ends the program."""

LOOK_S = 0.5
"""Between two looks whether the owner lives, where the kernel does not tell."""
END_S = 30.0
"""From the signal to SIGKILL; a recorder closes its bag in between."""

_PR_SET_PDEATHSIG = 1


def owner_variables(number: signal.Signals = signal.SIGTERM) -> dict[str, str]:
    """Return the variables for a program of ours that a signal ends if this process dies."""
    return {VARIABLE: f"{os.getpid()} {int(number)}"}


def command_with_owner(
    command: Sequence[str], number: signal.Signals = signal.SIGKILL
) -> list[str]:
    """Return the command for another's program that a signal ends if this process dies."""
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), str(int(number)), *command]


def follow_owner() -> None:
    """Have a signal end this process if its owner dies; for the beginning of a program.

    Nothing is done for a program that has no owner, such as one that a shell has started.
    """
    owner, _, number = os.environ.pop(VARIABLE, "").partition(" ")
    if owner.isdecimal() and number.isdecimal():
        end_with(int(owner), int(number))


def end_with(owner: int, number: int) -> None:
    """Have a signal end this process if another one dies.

    The kernel sends it where that is the parent. Behind another program, such as a debugger or a
    shell, a thread waits for the owner's end.
    """
    _ask_kernel(number)
    if os.getppid() != owner:
        threading.Thread(target=_follow, args=(owner, number), name="owner", daemon=True).start()


def _ask_kernel(number: int) -> None:
    """Have the kernel send a signal when the parent ends, also after `os.execvp`."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)


def _follow(owner: int, number: int) -> None:
    _wait_for_end(owner)
    os.kill(os.getpid(), number)
    time.sleep(END_S)
    os.kill(os.getpid(), signal.SIGKILL)


def _wait_for_end(process: int) -> None:
    """Return once there is no such process."""
    try:
        descriptor = os.pidfd_open(process)
    except ProcessLookupError:
        return
    except OSError:  # an old kernel, or a container that forbids it
        while _runs(process):
            time.sleep(LOOK_S)
        return
    waiting = select.poll()
    waiting.register(descriptor, select.POLLIN)
    waiting.poll()
    os.close(descriptor)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _become(owner: str, number: str, *command: str) -> None:
    """Replace this program by another's."""
    _ask_kernel(int(number))
    if not _runs(int(owner)):  # it died meanwhile
        os._exit(128 + int(number))
    try:
        os.execvp(command[0], command)  # noqa: S606 - the caller's command
    except OSError as error:
        sys.stderr.write(f"{command[0]}: {error.strerror}\n")
        os._exit(127)


if __name__ == "__main__":
    _become(*sys.argv[1:])
