"""How a command ends at SIGINT, SIGTERM, SIGHUP and SIGQUIT: quickly, one exit code, nothing left.

Python's way, an exception in the main thread, cannot promise that: Ray, Blender and others replace
handlers, crash where one is called within them, or drop the exception. So the work is done in a
child process, which the terminal's signals do not reach. This process does nothing but wait. At a
signal it kills the child and all that the child has started, removes what they left unfinished, and
exits with 128 and the signal's number. Whatever is finished is whole, because files are written
under other names first.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

from oaisys_core.system.standard_streams import printable

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a program; Ctrl-C sends the first one, and Ctrl-\\ the last."""

RECEIVED: list[int] = []
"""The signals that have interrupted this process, the first of which is its exit code."""

_SHOWN_CURSOR = b"\x1b[?25h\r\n"


def exit_at_signals() -> None:
    """Exit at once at a signal, before there is anything to be cleaned up.

    A signal that this process was started to ignore, as by ``nohup``, stays ignored.
    """
    _handle(lambda number, _: os._exit(128 + number))


def interrupt_at_signals() -> None:
    """Raise `KeyboardInterrupt` at a signal, whose number is added to `RECEIVED`.

    This is for programs that neither work in a child process nor handle signals themselves. A
    library may drop the exception, above all while it is imported: see `raise_if_received`.
    """
    _handle(_interrupt)
    raise_if_received()


def _interrupt(number: int, _: FrameType | None) -> NoReturn:
    RECEIVED.append(number)
    raise KeyboardInterrupt


def raise_if_received() -> None:
    """Raise `KeyboardInterrupt` if a signal has been received, even if it was dropped since."""
    if RECEIVED:
        raise KeyboardInterrupt


def has_dropped_interruption() -> bool:
    """Return whether `interrupt_at_signals` still holds, and a signal has ended nothing."""
    return bool(RECEIVED) and signal.getsignal(RECEIVED[0]) is _interrupt


def ignore_signals() -> None:
    """Ignore further signals in a program that ends, which as it is would be killed by them."""
    _handle(signal.SIG_IGN)


def end_at_signal(number: int) -> NoReturn:
    """Exit as a program that was ended by a signal, whatever threads or libraries still do."""
    exit_at_once(128 + number)


def exit_at_once(code: int) -> NoReturn:
    """Exit while threads still work in libraries, which would find their memory freed."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def work_in_child(command: str, grace_s: float = 0.0) -> None:
    """Go on in a child process; this process waits for it, and exits as it does.

    Args:
        command: Its name, for what is said at a signal.
        grace_s: How long the child may take to end by itself after `KeyboardInterrupt`; 0: it is
            killed at once.
    """
    from oaisys_core.system.ending.descendants import adopt_orphans, kill_descendants
    from oaisys_core.system.ending.last_words import LastWords, record_last_words
    from oaisys_core.system.ending.leftovers import Leftovers, record_leftovers

    record, words = Leftovers(), LastWords()
    adopt_orphans()
    sys.stdout.flush()
    sys.stderr.flush()
    parent = os.getpid()
    received: list[int] = []
    child = 0

    def stop(number: int, _: FrameType | None) -> None:
        is_first = not received
        received.append(number)
        is_late = number == signal.SIGALRM
        if not (child and (is_first or is_late)):
            return  # a second signal changes nothing
        if grace_s and not is_late:
            signal.setitimer(signal.ITIMER_REAL, grace_s)
        with suppress(ProcessLookupError):  # it has just ended
            os.kill(child, signal.SIGINT if grace_s and not is_late else signal.SIGKILL)

    _handle(stop)
    signal.signal(signal.SIGALRM, stop)
    child = os.fork()
    if not child:
        _begin_work(parent, is_interrupted=bool(grace_s))
        record_leftovers(record)
        record_last_words(words)
        return
    if received:  # between the handlers and the fork
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    child = 0
    if not received and os.WIFEXITED(status):
        text, kept = words.read()
        record.remove(kept)
        if text:  # a library has ended it
            _write_end(command, text)
            os._exit(1)
        os._exit(os.WEXITSTATUS(status))
    kill_descendants()
    record.remove()
    _say_end(command, received, status)


def _begin_work(parent: int, *, is_interrupted: bool) -> None:
    """Leave the terminal's foreground, and die with the parent."""
    from oaisys_core.system.ending.descendants import adopt_orphans, end_with_parent

    os.setpgid(0, 0)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    # Programs that are started get the default again, which they would not if it was ignored.
    _handle(lambda *_: None)
    if is_interrupted:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    end_with_parent(signal.SIGKILL)
    adopt_orphans(wanted=False)
    if os.getppid() != parent:
        os._exit(1)


def _say_end(command: str, received: list[int], status: int) -> NoReturn:
    """Say by what the command was ended, and exit."""
    number = received[0] if received else os.WTERMSIG(status)
    name = signal.Signals(number).name
    _write_end(command, f"stopped by {name}" if received else f"its process was ended by {name}")
    os._exit(128 + number if received else 1)


def _write_end(command: str, how: str) -> None:
    with suppress(OSError):
        if os.isatty(2):
            os.write(2, _SHOWN_CURSOR)  # the progress display has hidden it
        os.write(2, f"oaisys {command}: {printable(how)}\n".encode())


def end_service_at_signals(handler: Callable[[int, FrameType | None], object] | int) -> None:
    """Have the signals of `ENDING` call a handler of a server or node.

    SIGHUP stays ignored under ``nohup``. SIGINT does not, although shells have their background
    jobs ignore it: a service is ended by it wherever it runs.

    Raises:
        KeyboardInterrupt: A signal has come before, and its interruption was dropped.
    """
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)
    if handler is not signal.SIG_IGN:
        # Only now: a signal that comes from here on is the handler's.
        raise_if_received()


@contextmanager
def defer_signals() -> Iterator[None]:
    """Have signals that end a program handled after the block, such as one that writes a record.

    On another thread than the main one, which no handler interrupts, it does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    before = {number: each for number in ENDING if callable(each := signal.getsignal(number))}
    # A signal that comes while handlers are exchanged goes to the one from before, which may raise.
    is_deferred = False

    def defer(number: int, frame: FrameType | None) -> None:
        if is_deferred:
            received.append(number)
        else:
            before[signal.Signals(number)](number, frame)

    try:
        for number in before:
            signal.signal(number, defer)
        is_deferred = True
        yield
    finally:
        is_deferred = False
        for number, handler in before.items():
            signal.signal(number, handler)
        for each in received:
            signal.raise_signal(each)


def _handle(handler: object) -> None:
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)  # type: ignore[arg-type]
