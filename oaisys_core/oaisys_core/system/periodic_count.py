"""Counts of events for a log that gets a line about the first at once, and others once a minute."""

from __future__ import annotations

import time
from collections.abc import Callable

PERIOD_S = 60.0
"""At most one line in so many seconds."""


class PeriodicCount:
    """Counts events of one kind.

    Args:
        now_s: A clock.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._count, self._last = 0, ""
        self._taken_s = -PERIOD_S

    def add(self, event: str) -> None:
        """Count an event."""
        self._count, self._last = self._count + 1, event

    def take(self, *, at_once: bool = False) -> tuple[int, str]:
        """Return how many events are to be told, and the last; 0 if no line is due.

        Args:
            at_once: Whether a line is due anyway, because there will be no other.
        """
        now_s = self._now_s()
        if not self._count or not (at_once or now_s >= self._taken_s + PERIOD_S):
            return 0, ""
        count, self._count, self._taken_s = self._count, 0, now_s
        return count, self._last
