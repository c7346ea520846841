"""Lets long computations stop where nobody waits for them any more.

Who may lose interest says how that is found out, for all that is computed within a block; loops
that can take long ask. Threads that copy their caller's context ask the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


def _go_on() -> None:
    """Do not stop."""


_CHECK: ContextVar[Callable[[], None]] = ContextVar("interruption", default=_go_on)


@contextmanager
def interruptible(check: Callable[[], None]) -> Iterator[None]:
    """Have `stop_if_unwanted` call ``check``, which raises where the block's result is unwanted."""
    token = _CHECK.set(check)
    try:
        yield
    finally:
        _CHECK.reset(token)


def stop_if_unwanted() -> None:
    """Raise what says that nobody waits for the result, where that is so."""
    _CHECK.get()()
