"""Interrupts a long command by the signals that end it, whatever the main thread is doing."""

from __future__ import annotations

import time
from dataclasses import dataclass

from oaisys_core.system.ending.signals import RECEIVED, end_service_at_signals

ORDER_S = 5.0
"""How long everything that an experiment has started may take to end."""


@dataclass
class _Interruption:
    """Plain values: a handler that sets an event deadlocks where it interrupts another one."""

    requested: bool = False
    since_s: float = 0.0


_state = _Interruption()


def interrupt_on_signals() -> None:
    """Have the signals of `ENDING` raise `KeyboardInterrupt` in the main thread.

    A C library whose callback it is raised in prints and drops it; `raise_if_interrupted` raises it
    again. Further signals do not interrupt what the first one has ended in order, for `ORDER_S`.

    Raises:
        KeyboardInterrupt: A signal has come before, and its interruption was dropped.
    """

    def interrupt(number: int, _: object) -> None:
        RECEIVED.append(number)
        if _state.requested and time.monotonic() < _state.since_s + ORDER_S:
            return
        _state.requested, _state.since_s = True, time.monotonic()
        raise KeyboardInterrupt

    _state.requested = False
    end_service_at_signals(interrupt)


def raise_if_interrupted() -> None:
    """Raise `KeyboardInterrupt` if a signal has been received, even if it was dropped since."""
    if _state.requested:
        raise KeyboardInterrupt
