"""Who may use the simulator next: those who wait get it in the order in which they asked."""

from __future__ import annotations

import threading
from collections import deque
from types import TracebackType
from typing import NamedTuple


class _Waiting(NamedTuple):
    thread: int
    turn: threading.Event


class Turns:
    """A lock for one thread at a time, first come, first served; its holder may take it again.

    Python's own locks are not fair: who lets go and asks again at once, as a sweep does between
    two poses, would usually have it again before anybody who waits has woken up.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: deque[_Waiting] = deque()
        self._holder: int | None = None
        self._depth = 0

    def __enter__(self) -> None:
        self.acquire()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()

    @property
    def waiting(self) -> int:
        """How many threads wait for their turn."""
        return len(self._waiting)

    @property
    def taken(self) -> bool:
        """Whether it is anybody's turn."""
        return self._holder is not None

    def acquire(self, *, blocking: bool = True) -> bool:
        """Wait for the turn; without ``blocking``, return False where it is not free."""
        me = threading.get_ident()
        with self._lock:
            if self._holder in (None, me):
                self._holder = me
                self._depth += 1
                return True
            if not blocking:
                return False
            waiting = _Waiting(me, threading.Event())
            self._waiting.append(waiting)
        waiting.turn.wait()
        return True

    def release(self) -> None:
        """Give the turn to the one who has waited longest."""
        with self._lock:
            self._depth -= 1
            if self._depth > 0:
                return
            if not self._waiting:
                self._holder = None
                return
            following = self._waiting.popleft()
            self._holder, self._depth = following.thread, 1
            following.turn.set()
