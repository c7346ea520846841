"""How a server is told to end, and how it ends even if something in it hangs."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import threading
from collections.abc import Callable
from concurrent.futures import Future

_LOG = logging.getLogger(__name__)

_LOOK_UP_MS = 200
_LAST_S = 4.8
"""From the request to end until the process exits, whatever still runs in it."""


class EndRequest:
    """Lets a thread wait until another thread, or a signal handler, asks for the end.

    It uses a pipe: a signal handler that sets an event deadlocks if its thread holds the event's
    lock.
    """

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        self._requests = 0

    def request(self) -> None:
        """Ask for the end; threads and signal handlers may call this, more than once."""
        self._requests += 1
        with contextlib.suppress(BlockingIOError):
            os.write(self._write, b"e")

    @property
    def is_repeated(self) -> bool:
        """Whether the end was asked for more than once, and should come at once."""
        return self._requests > 1

    def wait(self) -> None:
        """Return once the end was asked for.

        It polls, because a signal just before a blocking call does not interrupt that call.
        """
        readable = select.poll()
        readable.register(self._read, select.POLLIN)
        while not readable.poll(_LOOK_UP_MS):
            pass


def exit_at_last(started: Future[None], clean_up: Callable[[], object]) -> None:
    """Let the process exit soon, even if a thread does not end; ``clean_up`` is called first."""
    failed = started.done() and started.exception() is not None

    def leave() -> None:
        try:
            _LOG.warning("something did not end within %g s; the process exits without it", _LAST_S)
            clean_up()
            logging.shutdown()
        finally:
            os._exit(1 if failed else 0)

    timer = threading.Timer(_LAST_S, leave)
    timer.daemon = True
    timer.start()
