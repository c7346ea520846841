"""Counts the calls that were ended for others, and tells of them once a minute."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from oaisys_core.system.periodic_count import PeriodicCount

_LOG = logging.getLogger(__name__)

_MAX_REASONS = 64


class EndedCalls:
    """Writes the first call of a reason to the log at once, and others as a number; any thread."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._counts: dict[str, PeriodicCount] = {}
        self._lock = threading.Lock()

    def add(self, call: str, reason: str) -> None:
        """Count a call.

        Args:
            call: Its method and connection.
            reason: Why it was ended; one of few.
        """
        with self._lock:
            if reason not in self._counts and len(self._counts) >= _MAX_REASONS:
                reason = "other reasons"
            self._counts.setdefault(reason, PeriodicCount(self._now_s)).add(call)
        self.tell()

    def tell(self, *, at_once: bool = False) -> None:
        """Write what is due to the log, or all that is not written yet."""
        with self._lock:
            for reason, counted in self._counts.items():
                count, last = counted.take(at_once=at_once)
                if count == 1:
                    _LOG.warning("%s: %s", last, reason)
                elif count:
                    _LOG.warning("%d calls, at last %s: %s", count, last, reason)
