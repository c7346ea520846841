"""Open calls: what each waits for, how many there may be, and the end of those that block others.

Each call holds a thread. One whose client never sends its request, or never reads its answer, would
hold it for ever.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any

import grpc

from oaisys_core.errors import QueueFullError
from oaisys_grpc.memory import IdleMemory
from oaisys_grpc.server.jobs.queue import QUEUE_LIMIT_OF_NEWCOMERS

_LOG = logging.getLogger(__name__)

REQUEST_PATIENCE_S = 10.0
"""For a request to arrive whole."""

STALL_PATIENCE_S = 30.0
"""For a client to read one message of an answer: 3 MiB at 100 kB/s."""

CROWDED_REQUESTS = 64
"""When this many calls wait for their requests, the oldest are ended."""

CROWDED_PATIENCE_S = 0.5
"""For a request to arrive, or for a client to read a message, while others need the thread.

Counted in looks of the thread that watches calls: on a starved machine this process may take longer
than that to see what its clients have long done.
"""

SLOT_PATIENCE_S = 15.0
"""For a slot among the calls of a method."""

MOST_WAITING = 16
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
    + MOST_WAITING * (len(LIMITS) + 1)
    + QUEUE_LIMIT_OF_NEWCOMERS
    + 2 * CROWDED_REQUESTS
    + _RESERVE
)
"""One for each stream, each unary call that waits for the worker, and each call whose request is
still to come."""

_LOOK_S = 0.25
_IDLE_S = 2.0
"""After so long without a call, freed memory is returned to the system."""


class Phase(Enum):
    """What a call waits for."""

    REQUEST = "its client to send a request"
    WORK = "the simulator"
    READER = "its client to read the answer"


class OpenCall:
    """One call; only its own thread calls `enter`."""

    def __init__(self, context: Any, name: str) -> None:
        self.peer: str = context.peer()
        self.name = name
        self.phase = Phase.REQUEST
        self.begun_s = self.since_s = time.monotonic()
        self.ended = False
        self._context = context
        self._looks, self._looked_since_s = 0, self.since_s

    def enter(self, phase: Phase) -> None:
        """Enter another phase, or the same one again."""
        self.phase, self.since_s = phase, time.monotonic()

    def look(self) -> None:
        """Count a look at its phase; only one thread calls this, every `_LOOK_S`."""
        since_s = self.since_s
        self._looks = self._looks + 1 if since_s == self._looked_since_s else 1
        self._looked_since_s = since_s

    def lags(self) -> bool:
        """Return whether it was in its phase at all looks of `CROWDED_PATIENCE_S`."""
        return self.since_s == self._looked_since_s and self._looks > CROWDED_PATIENCE_S / _LOOK_S

    def stuck_s(self) -> float:
        """Return how long it has been in its phase."""
        return time.monotonic() - self.since_s

    def end(self, details: str) -> None:
        """End the call with RESOURCE_EXHAUSTED; any thread may call this.

        No status can follow a message that is stuck, so the call is cancelled in gRPC's core, with
        a status, which gRPC's Python server does not offer to applications.
        """
        if self.ended:
            return
        self.ended = True
        _LOG.warning("%s of %s: %s", self.name, self.peer, details)
        event = getattr(self._context, "_rpc_event", None)
        if event is None:
            self._context.cancel()
        else:
            code, _ = grpc.StatusCode.RESOURCE_EXHAUSTED.value
            event.call.cancel(code, details.encode())


class OpenCalls:
    """All open calls, and the thread that ends stuck ones; safe for any thread."""

    def __init__(self) -> None:
        self._calls: set[OpenCall] = set()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._memory = IdleMemory()
        self._last_s = time.monotonic()
        threading.Thread(target=self._watch, name="open-calls", daemon=True).start()

    def add(self, context: Any, name: str) -> OpenCall:
        """Add a call whose request is still to be read, and return it."""
        call = OpenCall(context, name)
        with self._lock:
            self._calls.add(call)
            self._last_s = time.monotonic()
        when_over(context, lambda: self._remove(call))
        return call

    def _remove(self, call: OpenCall) -> None:
        with self._lock:
            self._calls.discard(call)
            self._last_s = time.monotonic()

    def close(self) -> None:
        """Let the thread end."""
        self._closed.set()

    def make_room(self) -> None:
        """End calls that wait for their requests, if there are many."""
        waiting = [call for call in self._all() if call.phase is Phase.REQUEST and not call.ended]
        if len(waiting) >= CROWDED_REQUESTS:
            for call in waiting:
                if call.lags():
                    call.end("the request did not arrive, and others need the room")

    def _all(self) -> list[OpenCall]:
        with self._lock:
            return list(self._calls)

    def _watch(self) -> None:
        while not self._closed.wait(_LOOK_S):
            for call in self._all():
                call.look()
            self.make_room()
            if time.monotonic() > self._last_s + _IDLE_S:
                self._memory.give_back()
            for call in self._all():
                stuck_s = call.stuck_s()
                if call.phase is Phase.REQUEST and stuck_s > REQUEST_PATIENCE_S:
                    call.end(f"the request did not arrive within {REQUEST_PATIENCE_S:g} s")
                if call.phase is Phase.READER and stuck_s > STALL_PATIENCE_S:
                    call.end(f"the answer was not read for {STALL_PATIENCE_S:g} s")


class Slots:
    """Limits the calls of a method, in total and by connection.

    If no slot is free, a call that its client does not read is ended for it: one of the same
    connection if that has its share, else any. Calls that wait are served in their order.
    """

    def __init__(self, most: int, *, idle_make_room: bool = False) -> None:
        """Start without calls.

        Args:
            most: Calls at a time.
            idle_make_room: Whether a call that waits for the simulator is ended for another one,
                too: of the connection that has the most calls, the oldest one.
        """
        self._idle_make_room = idle_make_room
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
        stuck = max(unread, key=OpenCall.stuck_s, default=None) if first else None
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
        if call.ended or (call not in self._waiting and len(self._waiting) >= MOST_WAITING):
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
        if call.peer.startswith("unix"):  # all clients of a socket have this name
            return []
        return [other for other in self._calls if other.peer == call.peer]


class StreamLimits:
    """Refuses calls beyond the limits of their methods, so that threads stay free for others."""

    def __init__(self) -> None:
        self._slots = {
            name: Slots(limit, idle_make_room=name in IDLE_MAKE_ROOM)
            for name, limit in LIMITS.items()
        }
        self._others = Slots(LIMIT_OF_OTHERS)

    @contextlib.contextmanager
    def slot(self, call: OpenCall) -> Iterator[None]:
        """Hold a slot for a stream.

        Raises:
            QueueFullError: There is none.
        """
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


def when_over(context: Any, action: Callable[[], None]) -> None:
    """Call ``action`` once a call has ended, for whatever reason."""
    if not context.add_callback(action):
        action()


def counted(calls: Iterator[Any], call: OpenCall) -> Iterator[Any]:
    """Yield a call's answers, and note when it waits for its reader."""
    for answer in calls:
        call.enter(Phase.READER)
        yield answer
        call.enter(Phase.WORK)
    call.enter(Phase.WORK)
