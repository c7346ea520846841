"""Decides whether another worker is started after several crashed."""

from __future__ import annotations

import collections
import logging
import time
from collections.abc import Callable

from oaisys_core.errors import BackendUnavailableError, OaisysError

_LOG = logging.getLogger(__name__)

CRASHES_ALLOWED = 3
CRASH_WINDOW_S = 60.0
"""After so many crashes within so many seconds, the next worker is started after a pause."""

FIRST_PAUSE_S = 10.0
LONGEST_PAUSE_S = 600.0
"""Each pause is twice as long as the last, until a worker has done some work."""


class Breaker:
    """Counts crashes; one thread reports them, any thread may ask for `refusal`."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._crashes_s: collections.deque[float] = collections.deque(maxlen=CRASHES_ALLOWED)
        self._pause_s = FIRST_PAUSE_S
        self._cause: OaisysError | None = None
        self._next_s = 0.0

    def crashed(self, error: OaisysError) -> None:
        """Note that a worker was lost, or could not be started."""
        now_s = self._now_s()
        if self._cause is not None and now_s > self._next_s + CRASH_WINDOW_S:
            self.worked()
        self._crashes_s.append(now_s)
        is_loop = now_s - self._crashes_s[0] < CRASH_WINDOW_S
        if self._cause is not None or (is_loop and len(self._crashes_s) == CRASHES_ALLOWED):
            self.pause(error)

    def pause(self, error: OaisysError) -> None:
        """Let no worker be started for a while, longer each time."""
        self._cause, self._next_s = error, self._now_s() + self._pause_s
        _LOG.error("no worker is started for %g s: %s", self._pause_s, error)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)

    def worked(self) -> None:
        """Note that a worker has finished a call, or has run long enough."""
        if self._cause is not None:
            _LOG.warning("a worker works again")
            self._cause, self._pause_s = None, FIRST_PAUSE_S
            self._crashes_s.clear()

    @property
    def refusal(self) -> BackendUnavailableError | None:
        """Why no worker may be started now, and when one may be; None: now."""
        cause, left_s = self._cause, self._next_s - self._now_s()
        if cause is None or left_s <= 0:
            return None
        return BackendUnavailableError(
            f"no worker runs any more: {cause}; another one is started in {left_s:.0f} s"
        )
