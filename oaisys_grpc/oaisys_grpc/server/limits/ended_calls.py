"""Counts the calls that were ended for others, and tells of them once a minute."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

_LOG = logging.getLogger(__name__)

PERIOD_S = 60.0
"""At most one line in so many seconds for each reason."""

_MAX_REASONS = 64


class _Tally:
    """Calls that ended for one reason since the last line."""

    def __init__(self) -> None:
        self.count, self.last, self.told_s = 0, "", -PERIOD_S


class EndedCalls:
    """Writes the first call of a reason to the log at once, and others as a number; any thread."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._tallies: dict[str, _Tally] = {}
        self._lock = threading.Lock()

    def add(self, call: str, reason: str) -> None:
        """Count a call.

        Args:
            call: Its method and connection.
            reason: Why it was ended; one of few.
        """
        with self._lock:
            if reason not in self._tallies and len(self._tallies) >= _MAX_REASONS:
                reason = "other reasons"
            tally = self._tallies.setdefault(reason, _Tally())
            tally.count, tally.last = tally.count + 1, call
        self.tell()

    def tell(self, *, at_once: bool = False) -> None:
        """Write what is due to the log, or all that is not written yet."""
        with self._lock:
            now_s = self._now_s()
            for reason, tally in self._tallies.items():
                if tally.count and (at_once or now_s >= tally.told_s + PERIOD_S):
                    _write(reason, tally)
                    tally.count, tally.told_s = 0, now_s


def _write(reason: str, tally: _Tally) -> None:
    if tally.count == 1:
        _LOG.warning("%s: %s", tally.last, reason)
    else:
        _LOG.warning("%d calls, at last %s: %s", tally.count, tally.last, reason)
