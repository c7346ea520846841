"""Open calls: what each waits for, and the end of those that wait for their clients for too long.

Each call holds a thread. One whose client never sends its request, or never reads its answer, would
hold it for ever.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from enum import Enum
from typing import Any

from oaisys_grpc.contract.connection_names import name_of
from oaisys_grpc.memory import IdleMemory
from oaisys_grpc.private.rpc_event import cancel, event_of_context
from oaisys_grpc.server.limits.ended_calls import EndedCalls

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

    def __init__(self, context: Any, name: str, calls: OpenCalls) -> None:
        self.peer: str = name_of(context)
        self._calls = calls
        self.name = name
        self.phase = Phase.REQUEST
        self.begun_s = self.since_s = time.monotonic()
        self.ended = False
        self._context = context
        self._looks, self._looked_since_s = 0, self.since_s

    def enter(self, phase: Phase) -> None:
        """Enter another phase, or the same one again."""
        if phase is Phase.WORK and self.phase is Phase.REQUEST:
            self._calls.on_request()
        self.phase, self.since_s = phase, time.monotonic()

    def look(self) -> None:
        """Count a look at its phase; only one thread calls this, every `_LOOK_S`."""
        since_s = self.since_s
        self._looks = self._looks + 1 if since_s == self._looked_since_s else 1
        self._looked_since_s = since_s

    def lags(self) -> bool:
        """Return whether it was in its phase at all looks of `CROWDED_PATIENCE_S`."""
        return self.since_s == self._looked_since_s and self._looks > CROWDED_PATIENCE_S / _LOOK_S

    def phase_s(self) -> float:
        """Return how long it has been in its phase."""
        return time.monotonic() - self.since_s

    def end(self, details: str) -> None:
        """End the call with RESOURCE_EXHAUSTED; any thread may call this."""
        if self.ended:
            return
        self.ended = True
        if self.phase is Phase.READER:
            self._calls.on_unread(self.peer)
        self._calls.ended.add(f"{self.name} of {self.peer}", details)
        if not cancel(event_of_context(self._context), details):
            self._context.cancel()


class OpenCalls:
    """All open calls, and the thread that ends stuck ones; safe for any thread.

    Attributes:
        ended: Counts the calls that were ended.
    """

    def __init__(
        self,
        on_request: Callable[[], None] = lambda: None,
        on_unread: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Start without calls.

        Args:
            on_request: Called on a call's thread when its request has come.
            on_unread: Called with the connection of a call that is ended because it is not read.
        """
        self.on_request, self.on_unread = on_request, on_unread
        self._calls: set[OpenCall] = set()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._memory = IdleMemory()
        self.ended = EndedCalls()
        self._last_s = time.monotonic()
        threading.Thread(target=self._watch, name="open-calls", daemon=True).start()

    def add(self, context: Any, name: str) -> OpenCall:
        """Add a call whose request is still to be read, and return it."""
        call = OpenCall(context, name, self)
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
        """Let the thread end, and tell what is not told yet."""
        self._closed.set()
        self.ended.tell(at_once=True)

    def _make_room(self) -> None:
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
            self._make_room()
            self.ended.tell()
            if time.monotonic() > self._last_s + _IDLE_S:
                self._memory.give_back()
            for call in self._all():
                stuck_s = call.phase_s()
                if call.phase is Phase.REQUEST and stuck_s > REQUEST_PATIENCE_S:
                    call.end(f"the request did not arrive within {REQUEST_PATIENCE_S:g} s")
                if call.phase is Phase.READER and stuck_s > STALL_PATIENCE_S:
                    call.end(f"the answer was not read for {STALL_PATIENCE_S:g} s")


def when_over(context: Any, action: Callable[[], None]) -> None:
    """Call ``action`` once a call has ended, for whatever reason."""
    if not context.add_callback(action):
        action()


def count_answers(
    calls: Iterator[Any], call: OpenCall, slot: Callable[[], AbstractContextManager[None]]
) -> Iterator[Any]:
    """Yield a call's answers, and note when it waits for its reader.

    Args:
        slot: Returns what each answer holds until it is read.
    """
    for answer in calls:
        with slot():
            call.enter(Phase.READER)
            yield answer
            call.enter(Phase.WORK)
    call.enter(Phase.WORK)
