"""One piece of work for the worker, from when it is asked for until it has ended."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from oaisys_core.errors import CancelledError, DeadlineExceededError, OaisysError
from oaisys_core.types import Frame, FrameName, Progress, Sample, SampleOutline
from oaisys_grpc.contract.faults import error_from_fault, fault_from_error
from oaisys_grpc.contract.operation import Kind, OperationStatus, State

_LOOK_S = 0.25
"""How often a follower looks after its caller."""

SampleFrames = tuple[SampleOutline, tuple[Frame, ...]]
Event = OperationStatus | SampleFrames


@dataclass(frozen=True)
class Work:
    """What the worker shall do.

    Attributes:
        kind: Of the operation; None for a question, which leaves no record.
        method, arguments: The worker's.
        timeout_s: From now until it must have ended, waiting included.
        request_id: The caller's; empty where it gave none.
        body: Digest of the request, to tell a repeated one from another with its id.
        like: Equal for work that takes about as long.
        request_bytes: Size of the request; what waits is bounded by it.
        peer: The connection that it came by; connections take turns.
    """

    kind: Kind | None
    method: str
    arguments: Mapping[str, Any]
    timeout_s: float
    request_id: str = ""
    body: bytes = b""
    like: Hashable = None
    request_bytes: int = 0
    peer: str = ""


@dataclass
class Operation:
    """One piece of work and how it stands; safe to use from any thread."""

    work: Work
    status: OperationStatus
    deadline_s: float
    result: Any = None
    cancelled: threading.Event = field(default_factory=threading.Event)
    _outline: SampleOutline | None = None
    _frames: list[Frame] = field(default_factory=list)
    _followers: int = 0
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def update(self, **changes: Any) -> bool:
        """Change the status, unless the operation has ended; return whether it was changed."""
        with self._changed:
            if self.status.state.ended:
                return False
            self.status = replace(self.status, **changes)
            if self.status.state.ended:  # it is remembered, but what was asked for is not
                self.work = replace(self.work, arguments={})
            self._changed.notify_all()
            return True

    def advance(self, progress: Progress) -> None:
        """Note how far it is."""
        self.update(progress=progress)

    def add_frames(self, outline: SampleOutline, frames: tuple[Frame, ...]) -> None:
        """Take frames in that are ready before the sample is."""
        with self._changed:
            if not self.status.state.ended:
                self._outline = outline
                self._frames.extend(frames)
                self._changed.notify_all()

    def stop(self, error: OaisysError) -> None:
        """End it now, unless it has ended; what the worker still makes of it is dropped."""
        state = State.CANCELLED if isinstance(error, CancelledError) else State.FAILED
        if self._end(state, error):
            self.cancelled.set()

    def expire(self) -> None:
        """End it if its time is over; the worker has a period of grace to stop."""
        if time.monotonic() >= self.deadline_s:
            self._end(State.FAILED, DeadlineExceededError("it did not end within its deadline"))

    def succeed(self, result: Any, batch_id: int, sample_id: int) -> None:
        """End it with a result; a large one is kept here only while somebody follows."""
        with self._changed:
            self.result = result if self._followers or self.work.kind is None else None
            done = Progress("done", 1.0)
            self.update(
                state=State.SUCCEEDED, progress=done, batch_id=batch_id, sample_id=sample_id
            )
            self._drop_frames()

    def complete(self, last_word: Sample, keep: Callable[[Sample], None]) -> bool:
        """End it with a sample, unless it has ended; return whether that was so.

        Args:
            last_word: The worker's, without the frames that came before it.
            keep: Given the whole sample before anybody hears of the end.
        """
        with self._changed:
            if self.status.state.ended:
                return False
            sample = last_word
            if self._outline is not None:
                came = (*self._frames, *last_word.frames)
                frames = {FrameName(frame.sensor, frame.modality): frame for frame in came}
                sample = replace(sample, frames=tuple(frames[n] for n in self._outline.frames))
            keep(sample)
            self.succeed(sample, sample.batch_id, sample.sample_id)
            return True

    def events(self, gone: threading.Event, patience_s: float = 0.0) -> Iterator[Event]:
        """Yield the status and frames, now and as they come, until the end or the caller is gone.

        Frames that came with the end may be missing. A status that frames or the end follow within
        ``patience_s`` is passed over: a sample that is found in the cache takes less than telling
        that it has begun.
        """
        seen: OperationStatus | None = None
        sent = 0
        while not gone.is_set():
            with self._changed:
                self._changed.wait_for(lambda: self._is_news(seen, sent), _LOOK_S)  # noqa: B023
                self._changed.wait_for(lambda: self._is_more(sent), patience_s)  # noqa: B023
                current, outline, frames = self.status, self._outline, self._frames[sent:]
            if current is not seen:
                seen = current
                yield current
            if current.state.ended:
                return
            if frames and outline is not None:
                yield outline, tuple(frames)
                sent += len(frames)

    def changes(self, gone: threading.Event) -> Iterator[OperationStatus]:
        """Yield the status now and at each change, until it has ended or the caller is gone."""
        for event in self.events(gone):
            if isinstance(event, OperationStatus):
                yield event

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
                self.expire()
                self.stop(CancelledError("the caller dropped the call"))

    def _is_news(self, seen: OperationStatus | None, sent: int) -> bool:
        return self.status is not seen or len(self._frames) > sent

    def _is_more(self, sent: int) -> bool:
        return self.status.state.ended or len(self._frames) > sent

    def _end(self, state: State, error: OaisysError) -> bool:
        """End it with an error, cut to what a client is told of it."""
        with self._changed:
            told = error_from_fault(fault_from_error(error))
            ended = self.update(state=state, error=told)
            if ended:
                self._drop_frames()
            return ended

    def _drop_frames(self) -> None:
        self._outline = None
        self._frames = []
