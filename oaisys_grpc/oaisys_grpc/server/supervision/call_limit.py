"""When a call to the worker must stop, and when the worker is killed for it."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

from oaisys_core.errors import CancelledError, DeadlineExceededError

CANCEL_WORK_S = 0.8
"""Processor time of its busiest thread in which a worker must stop a cancelled sample."""

CANCEL_IDLE_S = 2.0
"""Such a worker hangs if it used no processor time for so long."""

_WATCH_S = 0.25

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_USER, _SYSTEM = 11, 12
"""Fields of a thread's ``stat`` after the name in brackets."""


class Watchdog:
    """Kills a worker that hangs in the middle of a message, which blocks its caller.

    One thread polls the time; a timer for each call would be a thread for each call.
    """

    def __init__(self, kill: Callable[[], None]) -> None:
        self._kill = kill
        self._kill_at_s = math.inf
        self._ended = threading.Event()
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()

    def arm(self, left_s: float) -> None:
        """Kill the worker in so many seconds, unless disarmed before."""
        self._kill_at_s = time.monotonic() + left_s

    def disarm(self) -> None:
        """Kill it no more."""
        self._kill_at_s = math.inf

    def end(self) -> None:
        """Let the thread end."""
        self._ended.set()

    def _watch(self) -> None:
        while not self._ended.wait(_WATCH_S):
            if time.monotonic() >= self._kill_at_s:
                self._kill()


class Limit:
    """When a call must stop: when it is cancelled, or when its deadline has passed.

    A worker that does not stop within a grace period after the deadline is killed. After a mere
    cancellation it may work on until then, unless the call is worth a worker: then it is killed
    once it has worked for `CANCEL_WORK_S`, or has been idle for `CANCEL_IDLE_S`. Both are measured
    in processor time, so that a busy machine does not cost a worker.
    """

    def __init__(
        self,
        timeout_s: float,
        grace_s: float,
        cancelled: threading.Event,
        *,
        worth_a_worker: bool = False,
    ) -> None:
        self._deadline_s = time.monotonic() + timeout_s
        self._grace_s = grace_s
        self._cancelled = cancelled
        self._worth_a_worker = worth_a_worker

    @property
    def cancelled(self) -> bool:
        """Whether the call was cancelled."""
        return self._cancelled.is_set()

    @property
    def over(self) -> bool:
        """Whether the deadline has passed."""
        return time.monotonic() >= self._deadline_s

    def left_s(self) -> float:
        """Return the seconds until a worker that hangs is killed."""
        return max(0.0, self._deadline_s + self._grace_s - time.monotonic())

    def must_stop(self) -> bool:
        """Whether the call must be cancelled."""
        return self._cancelled.is_set() or self.over

    def must_kill(self, since_told: ProcessorTime | None) -> bool:
        """Return whether the worker must be killed.

        Args:
            since_told: Its processor time since it was told to stop; None: it was not told yet.
        """
        if self._worth_a_worker and self._cancelled.is_set() and since_told is not None:
            worked_s, idle_s = since_told.look()
            if worked_s >= CANCEL_WORK_S or idle_s >= CANCEL_IDLE_S:
                return True
        return time.monotonic() >= self._deadline_s + self._grace_s

    def error(self) -> CancelledError | DeadlineExceededError:
        """Return why the call was stopped."""
        if self._cancelled.is_set():
            return CancelledError("cancelled by the caller")
        return DeadlineExceededError("the operation did not end within its deadline")


class ProcessorTime:
    """The processor time of a process from now on, which does not depend on other processes."""

    def __init__(self, pid: int) -> None:
        self._threads = Path(f"/proc/{pid}/task")
        self._begin = self._last = self._ticks()
        self._moved_s = time.monotonic()

    def look(self) -> tuple[float, float]:
        """Return the busiest thread's processor time, and how long all threads have been idle.

        Both are in seconds. Call it often: activity counts from the call that notices it.
        """
        ticks = self._ticks()
        now_s = time.monotonic()
        if ticks != self._last:
            self._last, self._moved_s = ticks, now_s
        used = (count - self._begin.get(thread, 0) for thread, count in ticks.items())
        return max(used, default=0) / _TICKS_PER_S, now_s - self._moved_s

    def _ticks(self) -> dict[str, int]:
        ticks = {}
        for file in self._threads.glob("*/stat"):
            try:
                fields = file.read_text().rpartition(")")[2].split()
            except OSError:  # it has ended meanwhile
                continue
            ticks[file.parent.name] = int(fields[_USER]) + int(fields[_SYSTEM])
        return ticks
