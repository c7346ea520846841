"""How many calls of a method there may be, in total and by connection, and which ones make room."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any

from oaisys_core.errors import QueueFullError
from oaisys_grpc.server.jobs.queue import QUEUE_LIMIT_OF_NEWCOMERS
from oaisys_grpc.server.limits.open_calls import (
    CROWDED_PATIENCE_S,
    CROWDED_REQUESTS,
    OpenCall,
    Phase,
    when_over,
)

UNNAMED = ("unix:", "")
"""Names that any number of connections share."""

SLOT_PATIENCE_S = 15.0
"""For a slot among the calls of a method."""

MAX_WAITING = 16
"""Calls of a method that may wait for a slot; each holds a thread, too."""

LIMITS = {
    "WatchOperation": 64,
    "RenderSample": 48,
    "GetSample": 16,
    "GetGroundTruthMesh": 8,
    "GetHeightField": 8,
    "Watch": 32,
    "GetFrame": 32,
    "Drive": 8,
}
"""Calls at a time, by method; all stream but GetFrame, whose answer may be as large."""

QUEUED = frozenset({"RenderSample", "GetGroundTruthMesh", "GetHeightField"})
"""Methods whose calls wait in the queue of jobs, which bounds them.

Their limits are of answers that wait for their readers: a call that waits for the worker takes no
slot from others.
"""

ANSWERED_AT_LENGTH = QUEUED | {"GetSample", "Drive"}
"""Methods whose clients show that they read answers."""

IDLE_MAKE_ROOM = frozenset({"Watch"})
"""Methods whose clients only wait, and may call again: one of them ends for a newcomer."""

LIMIT_OF_OTHERS = 8
"""Other streams at a time, such as those of reflection."""

SHARE_OF_CONNECTION = 0.75
"""Share of each limit that one connection may have."""

_RESERVE = 24
"""Threads for calls that answer at once: health, cancellation, status."""

THREADS = (
    sum(LIMITS.values())
    + LIMIT_OF_OTHERS
    + MAX_WAITING * (len(LIMITS) + 1)
    + QUEUE_LIMIT_OF_NEWCOMERS
    + 2 * CROWDED_REQUESTS
    + _RESERVE
)
"""One for each stream, each unary call that waits for the worker, and each call whose request is
still to come."""


class Slots:
    """Limits the calls of a method, in total and by connection.

    If no slot is free, a call that its client does not read is ended for it: one of the same
    connection if that has its share, else any. Calls that wait are served in their order.
    """

    def __init__(
        self, most: int, *, most_waiting: int = MAX_WAITING, idle_make_room: bool = False
    ) -> None:
        """Start without calls.

        Args:
            most: Calls at a time.
            most_waiting: Calls that may wait for a slot.
            idle_make_room: Whether a call that waits for the simulator is ended for another one,
                too: of the connection that has the most calls, the oldest one.
        """
        self._idle_make_room, self._most_waiting = idle_make_room, most_waiting
        self._most, self._most_of_peer = most, int(SHARE_OF_CONNECTION * most)
        self._calls: dict[OpenCall, None] = {}
        self._waiting: dict[OpenCall, None] = {}
        self._lock = threading.Condition()

    def take(self, call: OpenCall) -> None:
        """Take a slot; wait a moment for one.

        A connection that has its share, and reads all of its answers, does not wait.

        Raises:
            QueueFullError: There is none.
        """
        end_s = time.monotonic() + SLOT_PATIENCE_S
        with self._lock:
            try:
                while (rivals := self._rivals(call)) is not None:
                    self._wait_for_room(call, rivals, end_s)
            finally:
                self._waiting.pop(call, None)
                self._lock.notify_all()
            self._calls[call] = None

    def _wait_for_room(self, call: OpenCall, rivals: list[OpenCall], end_s: float) -> None:
        """End one of the rivals, if that may be, or wait a moment."""
        unread = [other for other in rivals if other.phase is Phase.READER]
        first = self._earlier(call) == 0
        stuck = max(unread, key=OpenCall.phase_s, default=None) if first else None
        idle = self._oldest_idle(rivals) if first else None
        if stuck is not None and stuck.lags():
            self._end(stuck, "the answer was not read, and others need the room")
        elif idle is not None and idle.lags():
            self._end(idle, "others need the room; call again")
        elif time.monotonic() > end_s or not self._is_worth_waiting(call, unread):
            message = f"too many calls of {call.name} at a time; try again later"
            raise QueueFullError(message)
        else:
            self._waiting[call] = None
            self._lock.wait(CROWDED_PATIENCE_S / 10)

    def _end(self, call: OpenCall, details: str) -> None:
        del self._calls[call]
        call.end(details)

    def _is_worth_waiting(self, call: OpenCall, unread: list[OpenCall]) -> bool:
        if call.ended or (call not in self._waiting and len(self._waiting) >= self._most_waiting):
            return False
        return bool(unread) or len(self._own(call)) < self._most_of_peer

    def release(self, call: OpenCall) -> None:
        """Give a slot back."""
        with self._lock:
            self._calls.pop(call, None)
            self._lock.notify_all()

    def _oldest_idle(self, rivals: list[OpenCall]) -> OpenCall | None:
        """Return the call that makes room: of the connection with the most, the oldest idle one."""
        if not self._idle_make_room:
            return None
        by_peer = Counter(call.peer for call in rivals)
        idle = [call for call in rivals if call.phase is Phase.WORK]
        return max(idle, key=lambda call: (by_peer[call.peer], -call.begun_s), default=None)

    def _rivals(self, call: OpenCall) -> list[OpenCall] | None:
        """Return the calls of which one would have to end; None if a slot is free."""
        own = self._own(call)
        if len(own) >= self._most_of_peer:
            return own
        free = self._most - len(self._calls)
        return None if free > self._earlier(call) else list(self._calls)

    def _earlier(self, call: OpenCall) -> int:
        """Return how many calls came before and could take a slot."""
        earlier = 0
        for other in self._waiting:
            if other is call:
                break
            earlier += not other.ended and len(self._own(other)) < self._most_of_peer
        return earlier

    def _own(self, call: OpenCall) -> list[OpenCall]:
        """Return the calls of the same connection."""
        if call.peer in UNNAMED:
            return []
        return [other for other in self._calls if other.peer == call.peer]


class StreamLimits:
    """Refuses calls beyond the limits of their methods, so that threads stay free for others."""

    def __init__(self) -> None:
        self._slots = {
            name: Slots(
                limit,
                most_waiting=QUEUE_LIMIT_OF_NEWCOMERS if name in QUEUED else MAX_WAITING,
                idle_make_room=name in IDLE_MAKE_ROOM,
            )
            for name, limit in LIMITS.items()
        }
        self._others = Slots(LIMIT_OF_OTHERS)

    def slot(self, call: OpenCall) -> AbstractContextManager[None]:
        """Hold a slot for a stream, unless the queue bounds its method.

        Raises:
            QueueFullError: There is none.
        """
        return contextlib.nullcontext() if call.name in QUEUED else self._hold(call)

    def unread_slot(self, call: OpenCall) -> AbstractContextManager[None]:
        """Hold a slot for a message of such a stream until it is read.

        Raises:
            QueueFullError: There is none.
        """
        return self._hold(call) if call.name in QUEUED else contextlib.nullcontext()

    @contextlib.contextmanager
    def _hold(self, call: OpenCall) -> Iterator[None]:
        slots = self._slots.get(call.name, self._others)
        slots.take(call)
        try:
            yield
        finally:
            slots.release(call)

    def take(self, call: OpenCall, context: Any) -> None:
        """Take a slot for a unary call, if its method is limited, until its end.

        Raises:
            QueueFullError: There is none.
        """
        slots = self._slots.get(call.name)
        if slots is not None:
            slots.take(call)
            when_over(context, lambda: slots.release(call))
