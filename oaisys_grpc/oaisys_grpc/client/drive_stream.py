"""Timed drives as a client receives them: in the order of simulated time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from oaisys_core.errors import OaisysError
from oaisys_core.types import ODOMETRY, DriveInstant, DriveOutline
from oaisys_grpc.client.channel import translate_errors
from oaisys_grpc.client.sample_client import ProgressListener
from oaisys_grpc.client.sample_stream import SampleStream
from oaisys_grpc.contract.drive_messages import (
    instant_from_proto,
    measurement_counts,
    outline_from_header,
)
from oaisys_grpc.contract.operation import progress_from_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb


class DriveStream:
    """Iterates over a drive: everything at one time, then everything at the next.

    Attributes:
        outline: What the drive will consist of.
        received: How many measurements of each sensor have come.
    """

    def __init__(
        self,
        events: Iterable[pb.DriveResponse],
        *,
        frame_bytes: int,
        on_progress: ProgressListener | None = None,
        cancel: Callable[[], object] = lambda: None,
    ) -> None:
        """Wait for the drive to begin.

        Args:
            events: The messages of the call.
            frame_bytes: Most bytes that a frame may have.
            on_progress: Called with the progress of the whole drive while a sample renders.
            cancel: Cancels the call.

        Raises:
            OaisysError: The drive is refused.
        """
        self._events = iter(events)
        self._frame_bytes = frame_bytes
        self._on_progress = on_progress
        self._cancel = cancel
        self._sent: Mapping[str, int] | None = None
        self.received: Counter[str] = Counter()
        with translate_errors():
            first = next(self._events, pb.DriveResponse())
        if not first.HasField("header"):
            raise OaisysError("the drive did not begin with its header")
        self.outline: DriveOutline = outline_from_header(first.header)

    @property
    def counts(self) -> Mapping[str, int]:
        """How many measurements of each sensor the server has sent; known at the end.

        Raises:
            OaisysError: The drive has not ended.
        """
        if self._sent is None:
            raise OaisysError("the drive is incomplete: its end has not come")
        return self._sent

    def __iter__(self) -> Iterator[DriveInstant]:
        """Yield each instant, with its sample if a camera or a lidar is due.

        Raises:
            OaisysError: The drive failed, or a measurement is missing.
        """
        for event in self._after_progress():
            for message in event.instants.instants:
                instant = instant_from_proto(message)
                if instant.sensors:
                    stream = SampleStream(self._parts(), limit=self._frame_bytes)
                    instant = replace(instant, sample=stream.read())
                self._count(instant)
                yield instant
        if self.received != Counter(self.counts):
            raise OaisysError(f"received {dict(self.received)} of {dict(self.counts)} measurements")

    def cancel(self) -> None:
        """End the drive; a thread that iterates gets a `CancelledError`."""
        self._cancel()

    def _parts(self) -> Iterator[pb.SamplePart]:
        """Yield the parts of the next sample, and maybe of later ones."""
        for event in self._after_progress():
            if event.HasField("part"):
                yield event.part

    def _after_progress(self) -> Iterator[pb.DriveResponse]:
        """Yield what brings measurements; take in the progress and the end."""
        with translate_errors():
            for event in self._events:
                if event.HasField("end"):
                    self._sent = measurement_counts(event.end)
                elif not event.HasField("progress"):
                    yield event
                elif self._on_progress is not None:
                    self._on_progress(progress_from_proto(event.progress))

    def _count(self, instant: DriveInstant) -> None:
        self.received.update(reading.sensor for reading in instant.imus)
        self.received.update(instant.sensors)
        if instant.has_odometry:
            self.received[ODOMETRY] += 1
