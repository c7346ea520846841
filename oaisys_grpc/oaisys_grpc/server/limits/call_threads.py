"""The threads that run calls: as many as are needed, in turns of the connections.

gRPC's server takes any executor. The library's own pool never ends a thread, and serves calls in
the order in which they came: a thousand calls of one client stand before the next client's one.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, NamedTuple

from oaisys_grpc.private.rpc_event import cancel, event_of, peer_of
from oaisys_grpc.server.limits.open_calls import CROWDED_REQUESTS

MAX_QUEUED = 512
"""Calls that wait for a thread."""

MAX_WITHOUT_REQUEST = 2 * CROWDED_REQUESTS
"""Calls on threads whose requests are still to come."""

IDLE_S = 5.0
"""After so long without a call, a thread ends."""

CROWD = "more calls are open than the server has threads for"


class _Call(NamedTuple):
    future: Future[Any]
    run: Callable[[], Any]
    event: Any


class CallThreads(Executor):
    """Runs calls on up to a number of threads; safe for any thread.

    The next call is that of the connection with the fewest calls on threads. If too many calls
    wait, one of the connection with the most is ended.
    """

    def __init__(
        self, most: int, on_refusal: Callable[[str], None], *, idle_s: float = IDLE_S
    ) -> None:
        """Start no thread yet.

        Args:
            most: Threads at a time.
            on_refusal: Called with the connection of a call that was ended unserved.
            idle_s: After so long without a call, a thread ends.
        """
        self._most, self._idle_s, self._on_refusal = most, idle_s, on_refusal
        self._queues: OrderedDict[str, deque[_Call]] = OrderedDict()
        self._running: Counter[str] = Counter()
        self._threads, self._idle, self._queued, self._without_request = 0, 0, 0, 0
        self._closed = False
        self._own = threading.local()
        self._lock = threading.Condition()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run a call on one of the threads, as soon as it is its connection's turn."""
        event = event_of(args)
        call = _Call(Future(), lambda: fn(*args, **kwargs), event)
        peer = peer_of(event)
        with self._lock:
            if self._closed:
                raise RuntimeError("the threads of calls have been closed")
            self._queues.setdefault(peer, deque()).append(call)
            self._queued += 1
            dropped = self._drop_one() if self._queued > MAX_QUEUED else None
            self._wake()
        if dropped is not None:
            self._refuse(*dropped)
        return call.future

    def request_came(self) -> None:
        """Note that the request of this thread's call has come."""
        if self._own.waits:
            self._own.waits = False
            with self._lock:
                self._without_request -= 1
                self._wake()

    def _wake(self) -> None:
        """Have a thread take the next call, if one may."""
        if self._idle < self._turns() and self._threads < self._most:
            self._threads += 1
            threading.Thread(target=self._serve, name="rpc").start()
        self._lock.notify()

    def _turns(self) -> int:
        """Return how many calls threads may take now."""
        return min(self._queued, MAX_WITHOUT_REQUEST - self._without_request)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let each thread end after its call; calls that wait are left."""
        with self._lock:
            self._closed = True
            self._lock.notify_all()

    def _serve(self) -> None:
        while (taken := self._take()) is not None:
            peer, call = taken
            try:
                call.future.set_result(call.run())
            except BaseException as error:  # noqa: BLE001 - the future's to tell
                call.future.set_exception(error)
            del call, taken  # an idle thread must not keep the last call's messages
            with self._lock:
                self._without_request -= self._own.waits  # this thread takes the next call itself
                self._running[peer] -= 1
                self._running += Counter()  # without those that have none

    def _take(self) -> tuple[str, _Call] | None:
        """Wait for the next call; None: the thread is to end."""
        with self._lock:
            self._idle += 1
            self._lock.wait_for(lambda: self._turns() > 0 or self._closed, self._idle_s)
            self._idle -= 1
            if self._closed or self._turns() <= 0:
                self._threads -= 1
                return None
            peer = min(self._queues, key=self._running.__getitem__)
            call = self._queues[peer].popleft()
            self._forget(peer)
            self._running[peer] += 1
            self._without_request += 1
            self._own.waits = True
            return peer, call

    def _drop_one(self) -> tuple[str, _Call]:
        peer = max(self._queues, key=lambda peer: len(self._queues[peer]))
        call = self._queues[peer].pop()
        self._forget(peer)
        return peer, call

    def _forget(self, peer: str) -> None:
        """Count a call of a connection as no longer queued; the connection's turn is over."""
        self._queued -= 1
        if self._queues[peer]:
            self._queues.move_to_end(peer)
        else:
            del self._queues[peer]

    def _refuse(self, peer: str, call: _Call) -> None:
        cancel(call.event, CROWD)
        call.future.cancel()
        self._on_refusal(peer)
