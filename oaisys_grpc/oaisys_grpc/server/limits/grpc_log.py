"""Keeps clients from filling the log with what gRPC says of their metadata."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from oaisys_core.system.periodic_count import PeriodicCount

_LOGGER = logging.getLogger("grpc._cython.cygrpc")
"""Writes an error with a traceback for each value that is no UTF-8."""

_SHOWN = 200
"""Characters of a message; a client chose them."""


class GrpcLogLimit(logging.Filter):
    """Lets one line a minute of each kind through, with their number; safe from any thread."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now_s = now_s
        self._counts: dict[str, PeriodicCount] = {}
        self._lock = threading.Lock()

    def begin(self) -> None:
        """Limit what gRPC writes from now on."""
        _LOGGER.addFilter(self)

    def end(self) -> None:
        """Limit it no longer, and tell of what is not told yet."""
        _LOGGER.removeFilter(self)
        with self._lock:
            for counted in self._counts.values():
                count, last = counted.take(at_once=True)
                if count:
                    _LOGGER.error(*_line(count, last))

    def filter(self, record: logging.LogRecord) -> bool:
        """Count a record, which is of the kind of its unformatted message."""
        with self._lock:
            counted = self._counts.setdefault(str(record.msg), PeriodicCount(self._now_s))
            counted.add(record.getMessage()[:_SHOWN])
            count, last = counted.take()
        if not count:
            return False
        record.msg, *arguments = _line(count, last)
        record.args = tuple(arguments)
        record.exc_info = record.exc_text = None
        return True


def _line(count: int, last: str) -> tuple[str, *tuple[object, ...]]:
    return ("%s", last) if count == 1 else ("%d times, at last: %s", count, last)
