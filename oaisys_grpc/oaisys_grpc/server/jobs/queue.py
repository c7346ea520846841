"""The queue of jobs for the worker, with a record of each operation.

Jobs of one connection run in the order in which they came; connections take turns. A sample waits
for one batch of each other connection at most.
"""

from __future__ import annotations

import contextlib
import logging
import secrets
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from oaisys_core.errors import (
    CancelledError,
    InvalidInputError,
    NotFoundError,
    OaisysError,
    QueueFullError,
    quote,
)
from oaisys_core.types import Progress
from oaisys_grpc.contract.faults import OvertakenError, ServerUnavailableError
from oaisys_grpc.contract.operation import Kind, OperationStatus, State
from oaisys_grpc.contract.sample_messages import messages_from_bytes
from oaisys_grpc.server.jobs.job import Durations, Job, Operation, SampleStore
from oaisys_grpc.server.jobs.order import JobOrder
from oaisys_grpc.server.jobs.turns import Turns
from oaisys_grpc.server.supervision.supervisor import Supervisor
from oaisys_grpc.worker.protocol import WorkerMessage

_LOG = logging.getLogger(__name__)

QUEUE_LIMIT = 32
"""How many operations may wait."""

QUEUE_LIMIT_OF_NEWCOMERS = 96
"""How many may wait when a connection with no waiting operation adds one."""

QUEUE_BYTES = 32 << 20
"""Total size of the waiting requests."""

HISTORY_LIMIT = 256
"""How many operations are remembered after they ended."""

_DRAIN_LOOK_S = 0.05
_DEADLINE_LOOK_S = 0.05
_WAKE_S = 0.25
"""How often an idle queue checks that the worker runs."""


class OperationQueue:
    """The queue, the loop that runs its jobs, and a record of each operation.

    Attributes:
        samples: The most recent ones.
        turns: Whose job is next.
    """

    def __init__(self, supervisor: Supervisor) -> None:
        # Names of an earlier server must not mean other operations of this one.
        self._instance = secrets.token_hex(4)
        self._durations = Durations()
        self._supervisor = supervisor
        self.samples = SampleStore()
        self._waiting: deque[Operation] = deque()
        self._running: Operation | None = None
        self._begun_s = 0.0
        self._known: OrderedDict[str, Operation] = OrderedDict()
        self._by_request: dict[str, list[Operation]] = {}
        self._count = 0
        self.turns = Turns()
        self._order = JobOrder(self.turns)
        self._lock = threading.Condition()
        self._closed = False
        self._ending = threading.Event()

    def run(self) -> None:
        """Run jobs until `end`, on the thread that started the worker."""
        threading.Thread(target=self._watch, name="deadlines", daemon=True).start()
        while not self._ending.is_set():
            operation = self._next()
            if operation is None:
                with contextlib.suppress(OaisysError):
                    self._supervisor.ensure_worker()
                continue
            self._run_operation(operation)
            with self._lock:
                self._running = None

    def drain(self, timeout_s: float, at_once: Callable[[], bool]) -> None:
        """Refuse new jobs; wait for the others, up to ``timeout_s`` or until ``at_once()``."""
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

    @contextlib.contextmanager
    def follow(self, job: Job) -> Iterator[Operation]:
        """Enqueue a job as `submit` does; keep its sample until the block ends, see `Operation`."""
        # It may end, and others push its sample out of the store, before its caller asks.
        operation = self.submit(job, is_followed=True)
        with operation.leave_at_end():
            yield operation

    def submit(self, job: Job, *, is_followed: bool = False) -> Operation:
        """Enqueue a job; a repeated request gets its earlier operation, whoever repeats it.

        If that operation failed or was cancelled, the job is enqueued again.

        Args:
            job: The job.
            is_followed: Whether the caller follows the operation, see `follow`.

        Raises:
            QueueFullError: Too many wait.
            InvalidInputError: The request id came with another body before, by the same connection.
        """
        with self._lock:
            for before in self._by_request.get(job.request_id, ()):
                if _is_repeated(before, job):
                    if is_followed:
                        before.add_follower()
                    return before
            if self._closed or self._ending.is_set():
                raise ServerUnavailableError("the simulator is being ended")
            self._waiting = deque(o for o in self._waiting if not o.status.state.is_final)
            is_batch = job.kind is Kind.BATCH
            ahead = [o for o in self._waiting if not (is_batch and o.job.kind is Kind.SAMPLE)]
            displaced = self._make_room(ahead, job)
            overtaken = self._remove_samples() if is_batch else []
            operation = self._record(job)
            if is_followed:
                operation.add_follower()
            self._waiting.append(operation)
            self._lock.notify_all()
        for sample in overtaken:
            sample.stop(OvertakenError(f"overtaken by the batch of {operation.status.name}"))
        for other in displaced:
            other.stop(QueueFullError("the queue is full, and others need the room"))
        return operation

    def get(self, name: str) -> Operation:
        """Return an operation by name.

        Raises:
            NotFoundError: There is none, or it ended long ago.
        """
        with self._lock:
            operation = self._known.get(name)
        if operation is None:
            raise NotFoundError(
                f"there is no operation {quote(name)}; ended ones are forgotten in time"
            )
        return operation

    def cancel(self, name: str) -> Operation:
        """Cancel an operation by name; one that has ended stays as it is."""
        operation = self.get(name)
        operation.stop(CancelledError("cancelled by CancelOperation"))
        return operation

    def with_times(self, operation: Operation, status: OperationStatus) -> OperationStatus:
        """Return a status with the seconds that are left until the operation ends, if known."""
        left_s = None if status.state.is_final else self._remaining_s(operation)
        return replace(status, progress=replace(status.progress, seconds_left=left_s))

    def _remaining_s(self, operation: Operation) -> float | None:
        """Return how long an operation and all before it in the queue will take; None: unknown."""
        with self._lock:
            running, since_s = self._running, time.monotonic() - self._begun_s
            waiting = [o for o in self._waiting if not o.status.state.is_final]
        ahead = waiting[: waiting.index(operation) + 1] if operation in waiting else []
        if not ahead and operation is not running:
            return None
        left_s = [self._durations.median_s(o.job.estimate_key) for o in ahead]
        if running is not None:
            total_s = self._durations.median_s(running.job.estimate_key)
            left_s.append(None if total_s is None else max(0.0, total_s - since_s))
        known_s = [seconds for seconds in left_s if seconds is not None]
        return sum(known_s) if len(known_s) == len(left_s) else None

    def _watch(self) -> None:
        """End what is overdue, even if the worker has not noticed yet."""
        while not self._ending.wait(_DEADLINE_LOOK_S):
            with self._lock:
                candidates = [*self._waiting, *filter(None, [self._running])]
            for operation in candidates:
                operation.expire()

    def _next(self) -> Operation | None:
        with self._lock:
            self._lock.wait_for(lambda: self._waiting or self._ending.is_set(), _WAKE_S)
            if not self._waiting:
                return None
            operation = self._order.choose(self._waiting, self._count)
            self._waiting.remove(operation)
            self._running, self._begun_s = operation, time.monotonic()
            return self._running

    def _run_operation(self, operation: Operation) -> None:
        """Have the worker do the job, and end the operation as that ends."""
        job = operation.job
        operation.expire()
        if not operation.update(state=State.RUNNING, progress=Progress("started", 0.0)):
            return
        try:
            answer = self._answer(operation)
        except OaisysError as error:
            operation.stop(error)
            return
        except Exception as error:  # noqa: BLE001 - one failed call must not end the queue
            _LOG.exception("%s failed in the server", job.method)
            operation.stop(OaisysError(f"internal error: {type(error).__name__}: {error}"))
            return
        if job.kind is Kind.SAMPLE:
            rest = messages_from_bytes(answer.content, answer.arrays)
            is_cached = operation.from_cache
            if not operation.complete(rest, keep=self.samples.add):
                self._supervisor.withdraw()
                return
        else:
            is_cached = False
            batch_id = answer.head["batch_id"] if job.kind is Kind.BATCH else 0
            operation.succeed(batch_id=batch_id, reply=answer)
        if not is_cached:
            self._durations.add(job.estimate_key, time.monotonic() - self._begun_s)

    def _answer(self, operation: Operation) -> WorkerMessage:
        """Call the worker, note what it sends meanwhile, and return its answer."""
        job = operation.job
        steps = self._supervisor.call(
            job.method,
            job.request,
            timeout_s=operation.deadline_s - time.monotonic(),
            cancelled=operation.cancelled,
            client=job.peer,
        )
        for message in steps:
            if message.type == "frames":
                operation.add(messages_from_bytes(message.content, message.arrays))
            elif message.type == "progress":
                progress = Progress(message.head["stage"], message.head["fraction"])
                operation.update(progress=progress)
        return message

    def _record(self, job: Job) -> Operation:
        self._count += 1
        name = f"operations/{self._instance}-{self._count}"
        status = OperationStatus(name, job.kind or Kind.SAMPLE)
        operation = Operation(job, status, time.monotonic() + job.timeout_s, self._count)
        if job.kind is None:
            return operation
        self._known[name] = operation
        if job.request_id:
            others = self._by_request.get(job.request_id, [])
            others = [o for o in others if o.job.body != job.body]
            self._by_request[job.request_id] = [*others, operation]
        for old in list(self._known.values())[:-HISTORY_LIMIT]:
            if old.status.state.is_final:
                del self._known[old.status.name]
                self._forget_request(old)
        return operation

    def _make_room(self, ahead: Sequence[Operation], job: Job) -> list[Operation]:
        """Refuse a job if too many wait ahead of it; return an operation that it displaces.

        Of the connections with the least standing, below the job's, the last operation is.
        """
        try:
            _check_room(ahead, job)
        except QueueFullError:
            if not ahead:
                raise
            standing = self.turns.standing
            other = min(reversed(ahead), key=lambda o: standing(o.job.peer))
            if standing(other.job.peer) >= standing(job.peer):
                raise
            rest = [o for o in ahead if o is not other]
            _check_room(rest, job)
            self._waiting.remove(other)
            return [other]
        return []

    def _forget_request(self, old: Operation) -> None:
        kept = self._by_request.get(old.job.request_id, [])
        kept = [operation for operation in kept if operation is not old]
        if kept:
            self._by_request[old.job.request_id] = kept
        else:
            self._by_request.pop(old.job.request_id, None)

    def _remove_samples(self) -> list[Operation]:
        """Remove the samples from the queue; return them and the one that renders, if any."""
        candidates = [*self._waiting, *filter(None, [self._running])]
        overtaken = [o for o in candidates if o.job.kind is Kind.SAMPLE]
        self._waiting = deque(o for o in self._waiting if o.job.kind is not Kind.SAMPLE)
        return overtaken


def _check_room(ahead: Sequence[Operation], job: Job) -> None:
    """Refuse a job if too many wait ahead of it."""
    limit = QUEUE_LIMIT_OF_NEWCOMERS
    if any(operation.job.peer == job.peer for operation in ahead):
        limit = QUEUE_LIMIT
    if len(ahead) >= limit:
        raise QueueFullError(f"{len(ahead)} operations wait already; try again later")
    waiting_bytes = sum(operation.job.request_bytes for operation in ahead)
    if waiting_bytes + job.request_bytes > QUEUE_BYTES:
        raise QueueFullError(f"{waiting_bytes} bytes of requests wait already; try again later")


def _is_repeated(before: Operation, job: Job) -> bool:
    """Return whether a job repeats an earlier request of the same id and gets its operation.

    Two clients may happen to choose the same id for different requests.
    """
    if before.job.body != job.body:
        if before.job.peer != job.peer:
            return False
        raise InvalidInputError(
            "request_id", job.request_id, "a new id, or the request that came with it before"
        )
    state = before.status.state
    return not state.is_final or state is State.SUCCEEDED
