"""Stops long computations whose result is no longer wanted.

A caller sets a check for a block of code; long loops inside the block call it. Threads that copy
the caller's context use the same check.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


def _go_on() -> None:
    """Do nothing: the computation continues."""


_CHECK: ContextVar[Callable[[], None]] = ContextVar("interruption", default=_go_on)


@contextmanager
def interruptible(check: Callable[[], None]) -> Iterator[None]:
    """Let `stop_if_unwanted` call ``check``, which raises if the result is no longer wanted."""
    token = _CHECK.set(check)
    try:
        yield
    finally:
        _CHECK.reset(token)


def stop_if_unwanted() -> None:
    """Call the check of the enclosing `interruptible` block; it raises to stop the computation."""
    _CHECK.get()()
