"""A way to stop work that another thread does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from oaisys_core.errors import CancelledError


class Cancellation:
    """Asked for once, by any thread; stops the call that is under way then, and all later ones."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reason = ""
        self._stop: Callable[[], object] | None = None

    @property
    def reason(self) -> str:
        """Why the work shall stop; empty: it may go on."""
        return self._reason

    def request(self, reason: str) -> None:
        """Stop the work; the first reason stays."""
        with self._lock:
            self._reason = self._reason or reason
            if self._stop is not None:
                self._stop()

    def check(self) -> None:
        """Raise `CancelledError` where the work shall stop."""
        if self._reason:
            raise CancelledError(self._reason)

    @contextmanager
    def stopping_by(self, stop: Callable[[], object]) -> Iterator[None]:
        """Have ``stop`` called while the block runs, should the work be stopped.

        Raises:
            CancelledError: It had been before.
        """
        with self._lock:
            self.check()
            self._stop = stop
        try:
            yield
        finally:
            with self._lock:
                self._stop = None
