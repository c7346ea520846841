"""Jobs for the worker from the request to the end; recent samples, and how long jobs took."""

from __future__ import annotations

import contextlib
import statistics
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from oaisys_core.errors import CancelledError, DeadlineExceededError, NotFoundError, OaisysError
from oaisys_core.types import Progress
from oaisys_grpc.contract.faults import error_from_fault, fault_from_error
from oaisys_grpc.contract.operation import Kind, OperationStatus, State
from oaisys_grpc.contract.sample_messages import SampleMessages
from oaisys_grpc.worker.protocol import WorkerMessage

MAX_SAMPLES = 16
MAX_BYTES = 512 * 1024 * 1024
"""Of the samples that are kept."""

RECENT_S, MAX_RECENT = 2.0, 64
"""Age up to which samples are kept beyond `MAX_SAMPLES`, and how many then: their readers may still
have to open their shared memory."""

_DURATIONS_KEPT = 5
"""Of each kind of job."""

_KINDS_KEPT = 64
"""Kinds of jobs whose durations are kept; the least recent ones are forgotten."""

_LOOK_S = 0.25
"""How often a waiting call checks that its caller is still there."""

Event = OperationStatus | SampleMessages


@dataclass(frozen=True)
class Job:
    """What the worker shall do.

    Attributes:
        kind: Of the operation; None for a question, which is not recorded.
        method: See `oaisys_grpc.worker.calls.SimulationCalls`.
        request: The serialized message of the contract that the method takes.
        timeout_s: From now until it must have ended, including its time in the queue.
        request_id: The caller's; empty where it gave none.
        body: Digest of the request; it differs for different requests with the same id.
        estimate_key: Equal for jobs that take about as long.
        request_bytes: Size of the request; the queue is bounded by their sum.
        peer: The connection that the request came by; connections take turns.
    """

    kind: Kind | None
    method: str
    request: bytes
    timeout_s: float
    request_id: str = ""
    body: bytes = b""
    estimate_key: Hashable = None
    request_bytes: int = 0
    peer: str = ""


@dataclass
class Operation:
    """One job and how it stands; safe to use from any thread.

    Attributes:
        number: Counts the operations of a queue in the order of their requests.
        reply: The worker's answer to a question.
    """

    job: Job
    status: OperationStatus
    deadline_s: float
    number: int = 0
    reply: WorkerMessage | None = None
    cancelled: threading.Event = field(default_factory=threading.Event)
    _sample: SampleMessages | None = None
    _followers: int = 0
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def update(self, **changes: Any) -> bool:
        """Change the status unless the operation has ended; return whether it was changed."""
        with self._changed:
            if self.status.state.is_final:
                return False
            self.status = replace(self.status, **changes)
            if self.status.state.is_final:  # it is remembered, but its request is not
                self.job = replace(self.job, request=b"")
            self._changed.notify_all()
            return True

    @property
    def from_cache(self) -> bool:
        """Whether the sample that has begun was rendered before."""
        with self._changed:
            header = self._sample.header if self._sample is not None else None
            return header is not None and header.from_cache

    def add(self, piece: SampleMessages) -> None:
        """Add the next piece of the sample."""
        with self._changed:
            if not self.status.state.is_final:
                self._sample = self._sample or SampleMessages()
                self._sample.add(piece)
                self._changed.notify_all()

    def stop(self, error: OaisysError) -> None:
        """End it with an error, unless it has ended; the worker's later answer is dropped."""
        state = State.CANCELLED if isinstance(error, CancelledError) else State.FAILED
        if self._end(state, error):
            self.cancelled.set()

    def expire(self) -> None:
        """End it if its deadline has passed; the worker then has a grace period to stop."""
        if time.monotonic() >= self.deadline_s:
            self._end(State.FAILED, DeadlineExceededError("it did not end within its deadline"))

    def succeed(self, *, batch_id: int = 0, reply: WorkerMessage | None = None) -> None:
        """End a batch or a question."""
        with self._changed:
            self.reply = reply if self.job.kind is None else None
            done = Progress("done", 1.0)
            self.update(state=State.SUCCEEDED, progress=done, batch_id=batch_id)

    def complete(self, rest: SampleMessages, keep: Callable[[SampleMessages], None]) -> bool:
        """End a sample unless it has ended; return whether this call ended it.

        Args:
            rest: The last piece of the sample.
            keep: Called with the whole sample before any caller learns of the end.
        """
        with self._changed:
            if self.status.state.is_final:
                return False
            self.add(rest)
            assert self._sample is not None
            self._sample = self._sample.complete()
            keep(self._sample)
            ids = {"batch_id": self._sample.batch_id, "sample_id": self._sample.sample_id}
            self.update(state=State.SUCCEEDED, progress=Progress("done", 1.0), **ids)
            self._forget_unfollowed()
            return True

    def events(self, gone: threading.Event, patience_s: float = 0.0) -> Iterator[Event]:
        """Yield the status, and pieces of a sample, until the end or until the caller is gone.

        The pieces make up the whole sample where the operation succeeds while it is followed.

        Args:
            gone: Set when the caller is gone.
            patience_s: A status is left out if a piece follows within this time: a sample that
                comes from the cache takes less time than a message that it has begun.
        """
        yielded: OperationStatus | None = None
        count, has_header = 0, False
        while not gone.is_set():
            with self._changed:
                self._changed.wait_for(
                    lambda: self.status is not yielded or self._has_more(count),  # noqa: B023
                    _LOOK_S,
                )
                self._changed.wait_for(
                    lambda: self.status.state.is_final or self._has_more(count),  # noqa: B023
                    patience_s,
                )
                status, piece = self.status, self._piece(count, with_header=not has_header)
            if status is not yielded and not status.state.is_final:
                yield status
            yielded = status
            if piece is not None:
                yield piece
                count, has_header = count + len(piece.frames), True
            if status.state.is_final:
                yield status
                return

    def changes(self, gone: threading.Event) -> Iterator[OperationStatus]:
        """Yield the status now and at each change, until it has ended or the caller is gone."""
        for event in self.events(gone):
            if isinstance(event, OperationStatus):
                yield event

    def add_follower(self) -> None:
        """Keep the sample for one caller more, who must then use `leave_at_end`."""
        with self._changed:
            self._followers += 1

    @contextlib.contextmanager
    def leave_at_end(self) -> Iterator[None]:
        """Take a caller back after the block; cancel the operation when its last caller leaves."""
        try:
            yield
        finally:
            with self._changed:
                self._followers -= 1
                abandoned = not self._followers
                self._forget_unfollowed()
            if abandoned:
                self.expire()
                self.stop(CancelledError("the caller dropped the call"))

    def _has_more(self, count: int) -> bool:
        """Return whether more frames than so many have come."""
        return self._sample is not None and len(self._sample.frames) > count

    def _piece(self, count: int, *, with_header: bool) -> SampleMessages | None:
        """Return what has come of the sample after so many frames; None: nothing."""
        whole = self._sample
        if whole is None or not (self._has_more(count) or whole.end is not None):
            return None
        return SampleMessages(
            whole.header if with_header else None, whole.frames[count:], whole.end
        )

    def _end(self, state: State, error: OaisysError) -> bool:
        """End it with an error, cut to what a client is told of it, unless it has ended."""
        with self._changed:
            if self.status.state.is_final:
                return False
            self._sample = None
            return self.update(state=state, error=error_from_fault(fault_from_error(error)))

    def _forget_unfollowed(self) -> None:
        """Drop a large result that nobody waits for."""
        if not self._followers:
            self._sample = None


class SampleStore:
    """Keeps the most recent samples within bounds of number and memory; safe for any thread."""

    def __init__(self) -> None:
        """Start without samples."""
        self._samples: OrderedDict[tuple[int, int], tuple[float, SampleMessages]] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, sample: SampleMessages) -> None:
        """Keep a sample; drop the oldest ones if there are too many, but never this one."""
        with self._lock:
            key = (sample.batch_id, sample.sample_id)
            self._samples.pop(key, None)
            self._samples[key] = time.monotonic(), sample
            while len(self._samples) > 1 and self._is_full():
                self._samples.popitem(last=False)

    def get(self, batch_id: int, sample_id: int) -> SampleMessages:
        """Return a sample.

        Raises:
            NotFoundError: It was never rendered, or has been dropped.
        """
        with self._lock:
            found = self._samples.get((batch_id, sample_id))
        if found is None:
            raise NotFoundError(
                f"sample {sample_id} of batch {batch_id} is not here; "
                f"the last {MAX_SAMPLES} are kept"
            )
        return found[1]

    def _is_full(self) -> bool:
        size = sum(sample.nbytes for _, sample in self._samples.values())
        since_s, _ = next(iter(self._samples.values()))
        is_recent = time.monotonic() < since_s + RECENT_S
        most = MAX_RECENT if is_recent else MAX_SAMPLES
        return len(self._samples) > most or size > MAX_BYTES


class Durations:
    """How long the last jobs of each kind took; safe to use from any thread."""

    def __init__(self) -> None:
        self._seconds: OrderedDict[Hashable, deque[float]] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, kind: Hashable, seconds: float) -> None:
        """Remember how long a job took."""
        with self._lock:
            self._seconds.setdefault(kind, deque(maxlen=_DURATIONS_KEPT)).append(seconds)
            self._seconds.move_to_end(kind)
            while len(self._seconds) > _KINDS_KEPT:
                self._seconds.popitem(last=False)

    def median_s(self, kind: Hashable) -> float | None:
        """Return how long jobs of a kind take; None if there was none yet."""
        with self._lock:
            seconds = self._seconds.get(kind)
            return statistics.median(seconds) if seconds else None
