"""Stops long computations whose result is no longer wanted.

A caller sets a check for a block of code; long loops inside the block call it. Threads that copy
the caller's context use the same check. A library that runs for long without calling Python is
stopped by a second thread.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from oaisys_core.errors import OaisysError

_LOOK_S = 0.05
"""How often a second thread calls the check."""


def _go_on() -> None:
    """Do nothing: the computation continues."""


_CHECK: ContextVar[Callable[[], None]] = ContextVar("interruption", default=_go_on)


@contextmanager
def interruptible(check: Callable[[], None]) -> Iterator[None]:
    """Let `stop_if_unwanted` call ``check``, which raises if the result is no longer wanted.

    ``check`` raises an `OaisysError`, on whatever thread it is called.
    """
    token = _CHECK.set(check)
    try:
        yield
    finally:
        _CHECK.reset(token)


def stop_if_unwanted() -> None:
    """Call the check of the enclosing `interruptible` block; it raises to stop the computation."""
    _CHECK.get()()


def make_wanted_check() -> Callable[[], bool]:
    """Return a function that says, on any thread, whether the caller's result is still wanted."""
    check = _CHECK.get()

    def is_wanted() -> bool:
        try:
            check()
        except OaisysError:
            return False
        return True

    return is_wanted


@contextmanager
def stop_when_unwanted(stop: Callable[[], None]) -> Iterator[None]:
    """Call ``stop`` on a second thread while the result of the block is unwanted.

    It is called every 0.05 s until the block ends. The block then ends without an error: call
    `stop_if_unwanted` after it.
    """
    if _CHECK.get() is _go_on:
        yield
        return
    is_wanted = make_wanted_check()
    ended = threading.Event()

    def look() -> None:
        while not ended.wait(_LOOK_S):
            if not is_wanted():
                stop()

    thread = threading.Thread(target=look, name="interruption")
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
