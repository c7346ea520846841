"""Work for the worker: first in, first out, one at a time, with a record of each."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from oaisys_core.errors import (
    CancelledError,
    DeadlineExceededError,
    InvalidInputError,
    NotFoundError,
    OaisysError,
    QueueFullError,
)
from oaisys_core.types import Progress, Sample
from oaisys_grpc.faults import OvertakenError, ServerUnavailableError
from oaisys_grpc.operation import Kind, OperationStatus, State
from oaisys_grpc.sample_store import SampleStore
from oaisys_grpc.supervisor import Supervisor

_LOG = logging.getLogger(__name__)

QUEUE_LIMIT = 32
"""How many operations may wait."""

HISTORY_LIMIT = 256
"""How many operations are remembered after they ended."""

_DRAIN_LOOK_S = 0.05
_WAKE_S = 0.25
"""How often an idle runner looks after the worker, and a follower after its caller."""


@dataclass(frozen=True)
class Work:
    """What the worker shall do.

    Attributes:
        kind: Of the operation; None for a question, which leaves no record.
        method, arguments: The worker's.
        timeout_s: From now until it must have ended, waiting included.
        request_id: The caller's; empty where it gave none.
        body: The whole request, to tell a repeated one from another with its id.
    """

    kind: Kind | None
    method: str
    arguments: Mapping[str, Any]
    timeout_s: float
    request_id: str = ""
    body: bytes = b""


@dataclass
class Operation:
    """One piece of work and how it stands; safe to use from any thread."""

    work: Work
    status: OperationStatus
    deadline_s: float
    result: Any = None
    cancelled: threading.Event = field(default_factory=threading.Event)
    _followers: int = 0
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def update(self, **changes: Any) -> bool:
        """Change the status, unless the operation has ended; return whether it was changed."""
        with self._changed:
            if self.status.state.ended:
                return False
            self.status = replace(self.status, **changes)
            self._changed.notify_all()
            return True

    def advance(self, progress: Progress) -> None:
        """Note how far it is."""
        self.update(progress=progress)

    def stop(self, error: OaisysError) -> None:
        """End it now, unless it has ended; what the worker still makes of it is dropped."""
        overtaken_or_cancelled = isinstance(error, CancelledError)
        state = State.CANCELLED if overtaken_or_cancelled else State.FAILED
        if self.update(state=state, error=error):
            self.cancelled.set()

    def succeed(self, result: Any, batch_id: int, sample_id: int) -> None:
        """End it with a result; a large one is kept here only while somebody follows."""
        with self._changed:
            self.result = result if self._followers or self.work.kind is None else None
            done = Progress("done", 1.0)
            self.update(
                state=State.SUCCEEDED, progress=done, batch_id=batch_id, sample_id=sample_id
            )

    def changes(self, gone: threading.Event) -> Iterator[OperationStatus]:
        """Yield the status now and at each change, until it has ended or the caller is gone."""
        seen: OperationStatus | None = None
        while not gone.is_set():
            with self._changed:
                self._changed.wait_for(lambda: self.status is not seen, _WAKE_S)  # noqa: B023
                current = self.status
            if current is not seen:
                seen = current
                yield current
            if current.state.ended:
                return

    @contextlib.contextmanager
    def followed(self) -> Iterator[None]:
        """Keep the result for this caller; when the last one leaves early, cancel."""
        with self._changed:
            self._followers += 1
        try:
            yield
        finally:
            with self._changed:
                self._followers -= 1
                abandoned = not self._followers
                if abandoned:
                    self.result = None
            if abandoned:
                self.stop(CancelledError("the caller dropped the call"))


class Operations:
    """The queue, the thread that works it off, and what is remembered."""

    def __init__(self, supervisor: Supervisor, samples: SampleStore) -> None:
        self._supervisor = supervisor
        self._samples = samples
        self._waiting: deque[Operation] = deque()
        self._running: Operation | None = None
        self._known: OrderedDict[str, Operation] = OrderedDict()
        self._by_request: dict[str, Operation] = {}
        self._count = 0
        self._lock = threading.Condition()
        self._closed = False
        self._ending = threading.Event()

    def run(self) -> None:
        """Work until `end`, on the thread that started the worker."""
        while not self._ending.is_set():
            operation = self._next()
            if operation is None:
                with contextlib.suppress(OaisysError):
                    self._supervisor.tend()
                continue
            self._work_off(operation)
            with self._lock:
                self._running = None

    def drain(self, timeout_s: float, at_once: Callable[[], bool]) -> None:
        """Refuse new work; wait up to ``timeout_s`` for what there is, unless told ``at_once``."""
        end_s = time.monotonic() + timeout_s
        with self._lock:
            self._closed = True
            while self._waiting or self._running is not None:
                if at_once() or time.monotonic() >= end_s:
                    return
                self._lock.wait(_DRAIN_LOOK_S)

    def end(self) -> None:
        """Stop everything and let `run` return."""
        self._ending.set()
        error = ServerUnavailableError("the simulator has been ended")
        with self._lock:
            open_operations = [*self._waiting, *filter(None, [self._running])]
            self._waiting.clear()
            self._lock.notify_all()
        for operation in open_operations:
            operation.stop(error)

    def submit(self, work: Work) -> Operation:
        """Enqueue work; a repeated request gets the operation that it got before.

        Raises:
            QueueFullError: Too many wait.
            InvalidInputError: The request id came with another body before.
        """
        with self._lock:
            before = self._by_request.get(work.request_id)
            if before is not None:
                return _same_request(before, work)
            if self._closed or self._ending.is_set():
                raise ServerUnavailableError("the simulator is being ended")
            overtaken = self._overtaken() if work.kind is Kind.BATCH else []
            self._waiting = deque(o for o in self._waiting if not o.status.state.ended)
            if len(self._waiting) >= QUEUE_LIMIT:
                raise QueueFullError(f"{QUEUE_LIMIT} operations wait already; try again later")
            operation = self._record(work)
            self._waiting.append(operation)
            self._lock.notify_all()
        for sample in overtaken:
            sample.stop(OvertakenError(f"overtaken by the batch of {operation.status.name}"))
        return operation

    def get(self, name: str) -> Operation:
        """Return an operation by name.

        Raises:
            NotFoundError: There is none, or it ended long ago.
        """
        with self._lock:
            operation = self._known.get(name)
        if operation is None:
            raise NotFoundError(f"there is no operation {name!r}; ended ones are forgotten in time")
        return operation

    def cancel(self, name: str) -> Operation:
        """Cancel an operation by name; one that has ended stays as it is."""
        operation = self.get(name)
        operation.stop(CancelledError("cancelled by CancelOperation"))
        return operation

    def _next(self) -> Operation | None:
        with self._lock:
            self._lock.wait_for(lambda: self._waiting or self._ending.is_set(), _WAKE_S)
            if not self._waiting:
                return None
            self._running = self._waiting.popleft()
            return self._running

    def _work_off(self, operation: Operation) -> None:
        work = operation.work
        remaining_s = operation.deadline_s - time.monotonic()
        if remaining_s <= 0:
            operation.stop(DeadlineExceededError("its deadline passed while it waited"))
        if not operation.update(state=State.RUNNING, progress=Progress("started", 0.0)):
            return
        try:
            result = self._supervisor.call(
                work.method,
                work.arguments,
                timeout_s=remaining_s,
                cancelled=operation.cancelled,
                progress=operation.advance,
            )
        except OaisysError as error:
            operation.stop(error)
            return
        except Exception as error:  # noqa: BLE001 - one failed call must not end the queue
            _LOG.exception("%s failed in the server", work.method)
            operation.stop(OaisysError(f"internal error: {type(error).__name__}: {error}"))
            return
        if isinstance(result, Sample):
            self._samples.add(result)
            operation.succeed(result, result.batch_id, result.sample_id)
        else:
            operation.succeed(result, result if work.kind is Kind.BATCH else 0, 0)

    def _record(self, work: Work) -> Operation:
        self._count += 1
        name = f"operations/{self._count}"
        status = OperationStatus(name, work.kind or Kind.SAMPLE)
        operation = Operation(work, status, time.monotonic() + work.timeout_s)
        if work.kind is None:
            return operation
        self._known[name] = operation
        if work.request_id:
            self._by_request[work.request_id] = operation
        for old in list(self._known.values())[:-HISTORY_LIMIT]:
            if old.status.state.ended:
                del self._known[old.status.name]
                self._by_request.pop(old.work.request_id, None)
        return operation

    def _overtaken(self) -> list[Operation]:
        """Take the samples out of the queue, and return them and one that renders."""
        candidates = [*self._waiting, *filter(None, [self._running])]
        overtaken = [o for o in candidates if o.work.kind is Kind.SAMPLE]
        self._waiting = deque(o for o in self._waiting if o.work.kind is not Kind.SAMPLE)
        return overtaken


def _same_request(before: Operation, work: Work) -> Operation:
    if before.work.body != work.body:
        raise InvalidInputError(
            "request_id", work.request_id, "a new id, or the request that came with it before"
        )
    return before
