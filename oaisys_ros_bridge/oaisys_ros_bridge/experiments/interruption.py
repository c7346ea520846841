"""Interrupts a long command by SIGINT and SIGTERM, whatever the main thread is doing."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass
class _Interruption:
    """Plain values: a handler that sets an event deadlocks where it interrupts another one."""

    requested: bool = False
    depth: int = 0
    pending: bool = False


_state = _Interruption()


def interrupt_on_signals() -> None:
    """Have SIGINT and SIGTERM raise `KeyboardInterrupt` in the main thread.

    A C library whose callback it is raised in prints and drops it; `raise_if_interrupted` raises it
    again.
    """

    def interrupt(*_: object) -> None:
        _state.requested = True
        if _state.depth:
            _state.pending = True
        else:
            raise KeyboardInterrupt

    _state.requested = False
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)


def raise_if_interrupted() -> None:
    """Raise `KeyboardInterrupt` if a signal has been received, even if it was dropped since."""
    if _state.requested:
        raise KeyboardInterrupt


@contextmanager
def defer_interruption() -> Iterator[None]:
    """Raise the `KeyboardInterrupt` of a signal only after the block; for the main thread."""
    _state.depth += 1
    try:
        yield
    finally:
        _state.depth -= 1
        if _state.pending and not _state.depth:
            _state.pending = False
            raise KeyboardInterrupt
