"""Interrupts a long command by SIGINT and SIGTERM, whatever the main thread is doing."""

from __future__ import annotations

import signal
import threading

_requested = threading.Event()


def interrupt_on_signals() -> None:
    """Have SIGINT and SIGTERM raise `KeyboardInterrupt` in the main thread.

    A C library whose callback it is raised in prints and drops it; `raise_if_interrupted` raises it
    again.
    """

    def interrupt(*_: object) -> None:
        _requested.set()
        raise KeyboardInterrupt

    _requested.clear()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)


def raise_if_interrupted() -> None:
    """Raise `KeyboardInterrupt` if a signal has been received, even if it was dropped since."""
    if _requested.is_set():
        raise KeyboardInterrupt
