"""Ctrl-C and SIGTERM of a long command, which are not lost whatever the main thread is doing."""

from __future__ import annotations

import signal
import threading

_asked = threading.Event()


def interrupt_on_signals() -> None:
    """Have SIGINT and SIGTERM raise `KeyboardInterrupt`, so that what was started is ended.

    The exception is lost where it is raised inside a callback of a C library, which prints and
    drops it; `raise_if_interrupted` raises it again.
    """

    def interrupt(*_: object) -> None:
        _asked.set()
        raise KeyboardInterrupt

    _asked.clear()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)


def raise_if_interrupted() -> None:
    """Raise `KeyboardInterrupt` where a signal has come, even if it was lost since."""
    if _asked.is_set():
        raise KeyboardInterrupt
