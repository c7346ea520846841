"""Timed drives: the trajectories that clients have set, and a drive as a sequence of jobs."""

from __future__ import annotations

import itertools
import secrets
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from oaisys_core.errors import InvalidInputError, NotFoundError, NotReadyError, OaisysError, quote
from oaisys_core.types import ODOMETRY, Progress
from oaisys_grpc.contract.drive_messages import counts_to_proto
from oaisys_grpc.contract.faults import UnknownTrajectoryError
from oaisys_grpc.contract.metadata import metadata_from_proto, names
from oaisys_grpc.contract.operation import OperationStatus, progress_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

MAX_TRAJECTORIES = 16
"""Trajectories that are kept."""

BLOCK = 500
"""Instants that are asked of the worker at a time."""


class TrajectoryStore:
    """Keeps the trajectories that were set last; safe to use from any thread."""

    def __init__(self) -> None:
        # Names of an earlier server must not mean other trajectories of this one.
        self._instance = secrets.token_hex(4)
        self._numbers = itertools.count(1)
        self._kept: OrderedDict[str, pb.Trajectory] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, trajectory: pb.Trajectory) -> pb.Trajectory:
        """Name a trajectory, keep it, and return it."""
        with self._lock:
            trajectory.name = f"trajectories/{self._instance}-{next(self._numbers)}"
            self._kept[trajectory.name] = trajectory
            while len(self._kept) > MAX_TRAJECTORIES:
                self._kept.popitem(last=False)
        return trajectory

    def get(self, name: str) -> pb.Trajectory:
        """Return a trajectory by name; the newest one if the name is empty.

        Raises:
            NotReadyError: None has been set.
            NotFoundError: It was never set, or has been forgotten.
        """
        with self._lock:
            if not self._kept:
                raise NotReadyError("there is no trajectory yet: set one first (SetTrajectory)")
            newest = next(reversed(self._kept))
            found = self._kept.get(name or newest)
        if found is None:
            message = f"there is no trajectory {quote(name)}; at most {MAX_TRAJECTORIES} are kept"
            raise NotFoundError(message)
        return found


@dataclass(frozen=True)
class DriveWork:
    """What a drive needs of the server.

    Attributes:
        ask: Has the worker answer a question about a drive: its method and request.
        render: Has the worker render a sample; yields its parts, and the status meanwhile.
        gone: Set when the client is gone, which ends the drive.
    """

    ask: Callable[[str, pb.DriveStep], bytes]
    render: Callable[[pb.DriveStep], Iterator[pb.SamplePart | OperationStatus]]
    gone: threading.Event


class DriveJobs:
    """Runs one drive, in jobs of the queue.

    Args:
        request: A client's request.
        trajectory: The trajectory that it names.
        work: How the jobs are done.

    Raises:
        InvalidInputError: The request has too many names, a pose, or metadata that are none.
    """

    def __init__(
        self, request: pb.DriveRequest, trajectory: pb.Trajectory, work: DriveWork
    ) -> None:
        names(request.sensors, "sensors")
        if request.metadata.sensor.HasField("pose"):
            raise InvalidInputError("metadata.sensor.pose", "a pose", "none: the trajectory has it")
        metadata_from_proto(request.metadata)
        self._metadata = request.metadata if request.HasField("metadata") else None
        self._trajectory = trajectory
        self._step = pb.DriveStep(sensors=request.sensors)
        self._step.trajectory.name = trajectory.name
        self._work = work
        self._due: dict[str, int] = {}
        self._sent: dict[str, int] = {}

    def events(self) -> Iterator[pb.DriveResponse]:
        """Yield the messages of the drive; if it fails, its end comes before the error.

        Raises:
            OaisysError: The drive failed.
        """
        header = pb.DriveHeader.FromString(self._ask_worker("drive_header"))
        self._due = {count.sensor: count.due for count in header.counts}
        self._sent = dict.fromkeys(self._due, 0)
        self._step.batch_id = header.batch_id
        yield pb.DriveResponse(header=header)
        try:
            yield from self._measurements(header.instant_count)
        except OaisysError:
            yield self._end()
            raise
        yield self._end()

    def _measurements(self, total: int) -> Iterator[pb.DriveResponse]:
        for first in range(0, total, BLOCK):
            self._step.first, self._step.count = first, BLOCK
            found = self._ask_worker("drive_instants")
            group = pb.DriveInstants()
            for index, instant in enumerate(pb.DriveInstants.FromString(found).instants, first):
                group.instants.append(instant)
                if instant.sensors:
                    yield self._count(group)
                    group = pb.DriveInstants()
                    yield from self._sample(instant, index, total)
                if self._work.gone.is_set():
                    return
            if group.instants:
                yield self._count(group)

    def _count(self, group: pb.DriveInstants) -> pb.DriveResponse:
        """Return the message of some instants, whose measurements count as sent."""
        for instant in group.instants:
            for reading in instant.imus:
                self._sent[reading.sensor] += 1
            if instant.has_odometry:
                self._sent[ODOMETRY] += 1
        return pb.DriveResponse(instants=group)

    def _sample(
        self, instant: pb.DriveInstant, index: int, total: int
    ) -> Iterator[pb.DriveResponse]:
        step = pb.DriveStep()
        step.CopyFrom(self._step)
        step.time_ns = instant.time_ns
        step.due.extend(instant.sensors)
        if self._metadata is not None:
            step.metadata.CopyFrom(self._metadata)
        for event in self._render(step):
            if isinstance(event, OperationStatus):
                fraction = (index + event.progress.fraction) / total
                progress = Progress(event.progress.stage, fraction)
                yield pb.DriveResponse(progress=progress_to_proto(progress))
            else:
                yield pb.DriveResponse(part=event)
        self._metadata = None
        for name in instant.sensors:
            self._sent[name] += 1

    def _ask_worker(self, method: str) -> bytes:
        """Ask the worker; a worker that does not know the trajectory is sent it."""
        try:
            return self._work.ask(method, self._step)
        except UnknownTrajectoryError:
            return self._work.ask(method, self._whole(self._step))

    def _render(self, step: pb.DriveStep) -> Iterator[pb.SamplePart | OperationStatus]:
        """Have the worker render; it refuses an unknown trajectory before it begins."""
        try:
            yield from self._work.render(step)
        except UnknownTrajectoryError:
            yield from self._work.render(self._whole(step))

    def _whole(self, step: pb.DriveStep) -> pb.DriveStep:
        """Return a step with the poses of its trajectory."""
        whole = pb.DriveStep()
        whole.CopyFrom(step)
        whole.trajectory.CopyFrom(self._trajectory)
        return whole

    def _end(self) -> pb.DriveResponse:
        return pb.DriveResponse(end=pb.DriveEnd(counts=counts_to_proto(self._due, self._sent)))
