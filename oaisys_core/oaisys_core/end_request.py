"""How a program is told to end, by a signal or by one of its threads."""

from __future__ import annotations

import contextlib
import os
import select
import signal
from collections.abc import Iterator

_LOOK_UP_MS = 200
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


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

    @contextlib.contextmanager
    def requested_by_signals(self) -> Iterator[None]:
        """Have SIGINT and SIGTERM ask for the end during the block; for the main thread.

        They are ignored afterwards: at exit Python restores the default handlers, and a second
        signal would kill it; a terminal and ros2 launch each send one.
        """
        for number in _SIGNALS:
            signal.signal(number, lambda *_: self.request())
        try:
            yield
        finally:
            for number in _SIGNALS:
                signal.signal(number, signal.SIG_IGN)

    @property
    def made(self) -> bool:
        """Whether the end was asked for."""
        return self._requests > 0

    @property
    def repeated(self) -> bool:
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
