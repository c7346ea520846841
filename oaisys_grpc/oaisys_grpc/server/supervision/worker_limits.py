"""Limits of workers: the time of their calls, the memory that they hold, how often they crash."""

from __future__ import annotations

import collections
import logging
import math
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from oaisys_core.errors import (
    BackendUnavailableError,
    CancelledError,
    DeadlineExceededError,
    OaisysError,
)
from oaisys_grpc.memory import PAGE_BYTES

_LOG = logging.getLogger(__name__)

CANCEL_WORK_S = 3.0
"""Processor time of its busiest thread in which a worker must stop a cancelled sample."""

CANCEL_IDLE_S = 2.0
"""Such a worker hangs if it used no processor time for so long."""

_WATCH_S = 0.25

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_USER, _SYSTEM = 11, 12
"""Fields of a thread's ``stat`` after the name in brackets."""

MEGABYTE = 1_000_000
_AUTOMATIC_SHARE = 0.6
"""Share of the machine's memory, unless the user sets a limit."""

_KILL_FACTOR = 1.5
_GROWTH_FACTOR = 1.25

_CONTROL_GROUP_FILES = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)
"""Files with a container's limit, of versions 2 and 1."""

CRASHES_ALLOWED = 3
CRASH_WINDOW_S = 60.0
"""After so many crashes within so many seconds, the next worker is started after a pause."""

FIRST_PAUSE_S = 10.0
LONGEST_PAUSE_S = 600.0
"""Each pause is twice as long as the last, until a worker has done some work."""


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


class CallLimit:
    """When a call must stop: when it is cancelled, or when its deadline has passed.

    A worker that does not stop within a grace period after the deadline is killed. After a mere
    cancellation it may work on until then, unless the call may cost a worker: then it is killed
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
    def is_cancelled(self) -> bool:
        """Whether the call was cancelled."""
        return self._cancelled.is_set()

    @property
    def over(self) -> bool:
        """Whether the deadline has passed."""
        return time.monotonic() >= self._deadline_s

    def remaining_s(self) -> float:
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


@dataclass(frozen=True)
class MemoryLimits:
    """The memory at which a worker is replaced.

    Attributes:
        recycle_bytes: Above it, a new worker takes its place between two frames.
        kill_bytes: Above it, it is killed at once, before the machine runs out of memory.
    """

    recycle_bytes: float
    kill_bytes: float

    @classmethod
    def of(cls, limit_bytes: int | None) -> MemoryLimits:
        """Return the limits for the user's choice; None: by the machine's memory; 0: no limits."""
        if limit_bytes == 0:
            return cls(float("inf"), float("inf"))
        recycle_bytes = limit_bytes or _AUTOMATIC_SHARE * machine_bytes()
        return cls(recycle_bytes, _KILL_FACTOR * recycle_bytes)

    def outgrown(self, resident_bytes: int, needed_bytes: int) -> bool:
        """Return whether a new worker would help one that holds ``resident_bytes``.

        Args:
            needed_bytes: What it held after its first frame. A world that needs more than the
                limit is not built anew with every frame.
        """
        return resident_bytes > max(self.recycle_bytes, _GROWTH_FACTOR * needed_bytes)


def machine_bytes() -> int:
    """Return the memory of this machine, or of this container where that has less."""
    found = [os.sysconf("SC_PHYS_PAGES") * PAGE_BYTES]
    for file in _CONTROL_GROUP_FILES:
        try:
            found.append(int(file.read_text()))
        except (OSError, ValueError):  # there is no such file, or "max" is in it
            continue
    return min(found)


def oom_kills() -> int:
    """Return how many processes the kernel has killed for want of memory; 0 if it does not say."""
    try:
        counts = dict(line.split() for line in Path("/proc/vmstat").read_text().splitlines())
    except (OSError, ValueError):
        return 0
    return int(counts.get("oom_kill", 0))


class Breaker:
    """Counts crashes; one thread reports them, any thread may ask for `refusal`."""

    def __init__(
        self,
        now_s: Callable[[], float] = time.monotonic,
        *,
        state: str = "no worker runs any more",
        end: str = "another one is started",
    ) -> None:
        """Start without crashes.

        Args:
            now_s: A clock.
            state: What is refused during a pause, for errors.
            end: What happens after it.
        """
        self._now_s, self._state, self._end = now_s, state, end
        self._crashes_s: collections.deque[float] = collections.deque(maxlen=CRASHES_ALLOWED)
        self._pause_s = FIRST_PAUSE_S
        self._cause: OaisysError | None = None
        self._next_s = 0.0

    def note_crash(self, error: OaisysError) -> None:
        """Note that a worker was lost, or could not be started."""
        now_s = self._now_s()
        if self._cause is not None and now_s > self._next_s + CRASH_WINDOW_S:
            self.note_success()
        self._crashes_s.append(now_s)
        is_loop = now_s - self._crashes_s[0] < CRASH_WINDOW_S
        if self._cause is not None or (is_loop and len(self._crashes_s) == CRASHES_ALLOWED):
            self.pause(error)

    def pause(self, error: OaisysError) -> None:
        """Let no worker be started for a while, longer each time."""
        self._cause, self._next_s = error, self._now_s() + self._pause_s
        _LOG.error("%s; %s in %g s: %s", self._state, self._end, self._pause_s, error)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)

    def note_success(self) -> None:
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
        return BackendUnavailableError(f"{self._state}: {cause}; {self._end} in {left_s:.0f} s")
