"""A token by which one thread cancels the work of another."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from oaisys_core.errors import CancelledError


class Cancellation:
    """Requested by any thread; cancels the call that is under way, and refuses all later ones."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reason = ""
        self._stop: Callable[[], object] | None = None

    @property
    def reason(self) -> str:
        """Why the work is cancelled; empty: it is not."""
        return self._reason

    def request(self, reason: str) -> None:
        """Cancel the work; the first reason stays."""
        with self._lock:
            self._reason = self._reason or reason
            if self._stop is not None:
                self._stop()

    def check(self) -> None:
        """Raise `CancelledError` if the work is cancelled."""
        if self._reason:
            raise CancelledError(self._reason)

    @contextmanager
    def stopping_by(self, stop: Callable[[], object]) -> Iterator[None]:
        """Call ``stop`` if the work is cancelled while the block runs.

        Raises:
            CancelledError: It was cancelled before.
        """
        with self._lock:
            self.check()
            self._stop = stop
        try:
            yield
        finally:
            with self._lock:
                self._stop = None
