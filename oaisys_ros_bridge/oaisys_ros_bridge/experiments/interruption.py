"""Interrupts a long command by SIGINT and SIGTERM, whatever the main thread is doing."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

_requested = threading.Event()


@dataclass
class _Deferral:
    depth: int = 0
    pending: bool = False


_deferral = _Deferral()


def interrupt_on_signals() -> None:
    """Have SIGINT and SIGTERM raise `KeyboardInterrupt` in the main thread.

    A C library whose callback it is raised in prints and drops it; `raise_if_interrupted` raises it
    again.
    """

    def interrupt(*_: object) -> None:
        _requested.set()
        if _deferral.depth:
            _deferral.pending = True
        else:
            raise KeyboardInterrupt

    _requested.clear()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)


def raise_if_interrupted() -> None:
    """Raise `KeyboardInterrupt` if a signal has been received, even if it was dropped since."""
    if _requested.is_set():
        raise KeyboardInterrupt


@contextmanager
def deferred_interruption() -> Iterator[None]:
    """Raise the `KeyboardInterrupt` of a signal only after the block; for the main thread."""
    _deferral.depth += 1
    try:
        yield
    finally:
        _deferral.depth -= 1
        if _deferral.pending and not _deferral.depth:
            _deferral.pending = False
            raise KeyboardInterrupt
