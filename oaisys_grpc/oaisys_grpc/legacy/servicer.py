"""The original's service, ``oaisys.Oaisys``, beside ours: step, poll, read files."""
# ruff: noqa: N802 - the contract names the calls

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from enum import IntEnum
from math import isfinite
from typing import Any

import grpc

from oaisys_core.config.sections.sensing.sensors import PosePolicy
from oaisys_core.errors import InvalidInputError, OaisysError, QueueFullError
from oaisys_core.importing.frames import rig_pose
from oaisys_core.types import ModuleMetadata, Pose
from oaisys_grpc.contract.errors import forget_frames, printable
from oaisys_grpc.contract.metadata import metadata_to_proto
from oaisys_grpc.contract.operation import Kind, OperationStatus
from oaisys_grpc.contract.sample_messages import SampleMessages, sample_from_messages
from oaisys_grpc.legacy.files import LegacyFiles
from oaisys_grpc.pb.legacy import oaisys_pb2 as pb
from oaisys_grpc.pb.legacy import oaisys_pb2_grpc
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2
from oaisys_grpc.server.jobs.job import Job, Operation
from oaisys_grpc.server.jobs.queue import OperationQueue
from oaisys_grpc.server.jobs.requests import OPERATION_TIMEOUT_S
from oaisys_grpc.server.supervision.supervisor import Supervisor

_LOG = logging.getLogger(__name__)

LEGACY_SERVICE = pb.DESCRIPTOR.services_by_name["Oaisys"].full_name
ERROR_KEY = "oaisys-error"
"""Trailing metadata: why a step was refused or failed, for which the messages have no field."""

_NOT_ADMITTED = ("queued", "started")
"""Stages of a sample's progress before its pose was checked."""

Context = grpc.ServicerContext


class LegacyState(IntEnum):
    """What the original calls a state."""

    IDLE = 0
    BUSY = 1
    FINISHED = 2


@dataclass(frozen=True)
class Step:
    """The state of a step; one that was refused or failed is finished, without files."""

    state: LegacyState = LegacyState.IDLE
    files: Sequence[str] = ()
    error: OaisysError | None = None


class LegacyServicer(oaisys_pb2_grpc.OaisysServicer):
    """Serves the original's clients; every method may run on any thread.

    One step at a time: while a batch or a sample of this service is under way, another one is
    refused, so that no call changes the pose or the files of another. The result of a step is kept
    until the next one is accepted.

    The original refuses nothing, and its clients poll until a step is finished. So every step
    finishes here, too: one that was refused or failed without files, with the error beside it.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        operations: OperationQueue,
        files: LegacyFiles,
        on_end: Callable[[], None],
        pose_policy: PosePolicy,
    ) -> None:
        """Keep what the methods use.

        Args:
            on_end: Called when a client ends the simulation; must return at once.
            pose_policy: What happens to a pose under the ground or off the stage. The original
                admits every pose. With ``reject``, numbers that are not finite are refused, too;
                otherwise the rig stays where it is.
        """
        self._supervisor = supervisor
        self._operations = operations
        self._files = files
        self._on_end = on_end
        self._pose_policy = pose_policy
        self._batch, self._sample = Step(), Step()
        self._lock = threading.Lock()
        self._follower = ThreadPoolExecutor(1, "legacy")

    def StepBatch(self, _request: pb.StepBatchRequest, context: Context) -> pb.StepBatchReply:
        """Enqueue a batch, unless a step is under way."""
        try:
            self._begin(Job(Kind.BATCH, "step_batch", b"", OPERATION_TIMEOUT_S))
        except OaisysError as error:
            self._refuse(Kind.BATCH, error)
            _tell(context, error)
            return pb.StepBatchReply(successRet=False)
        return pb.StepBatchReply(successRet=True)

    def StepSample(self, request: pb.StepSampleRequest, context: Context) -> pb.StepSampleReply:
        """Enqueue a sample, unless a step is under way; answer once its pose was admitted."""
        try:
            metadata = metadata_to_proto(self._metadata(request))
            step = simulator_pb2.StepSampleRequest(metadata=metadata).SerializeToString()
            job = Job(Kind.SAMPLE, "step_sample", step, OPERATION_TIMEOUT_S)
            batch_id, sample_id = self._await_sample(*self._begin(job), context)
        except OaisysError as error:
            self._refuse(Kind.SAMPLE, error)
            _tell(context, error)
            return pb.StepSampleReply(successRet=False)
        return pb.StepSampleReply(successRet=True, batchID=batch_id, sampleID=sample_id)

    def RenderFinished(self, _request: pb.Empty, context: Context) -> pb.RenderFinishedReply:
        """Answer with the state of the last sample, and its files, as often as asked."""
        step = self._sample
        if step.error is not None:
            _tell(context, step.error)
        return pb.RenderFinishedReply(state=step.state, filePathList=step.files)

    def BatchCreationFinished(
        self, _request: pb.Empty, context: Context
    ) -> pb.BatchCreationFinishedReply:
        """Answer with the state of the last batch."""
        step = self._batch
        if step.error is not None:
            _tell(context, step.error)
        return pb.BatchCreationFinishedReply(state=step.state)

    def EndSimulation(self, _request: pb.Empty, _context: Context) -> pb.SuccessMsg:
        """Answer, and end the server."""
        self._on_end()
        return pb.SuccessMsg(successRet=True)

    def close(self) -> None:
        """Wait for what is being written; call once no operation is open any more."""
        self._follower.shutdown()

    def _metadata(self, request: pb.StepSampleRequest) -> ModuleMetadata:
        sensor: dict[str, Any] = {"pose_policy": self._pose_policy}
        if request.sensorModuleRequest.HasField("pose"):
            try:
                sensor["pose"] = rig_pose_from_blender(request.sensorModuleRequest.pose)
            except InvalidInputError as error:
                if self._pose_policy == "reject":
                    raise
                _LOG.warning("step_sample: %s; the rig stays where it is", error)
        return ModuleMetadata(sensor=sensor)

    def _refuse(self, kind: Kind, error: OaisysError) -> None:
        """Finish a step that never began, unless an earlier one has something to tell."""
        step = Step(LegacyState.FINISHED, error=error)
        with self._lock:
            if kind is Kind.BATCH and self._batch.state is LegacyState.IDLE:
                self._batch = step
            elif kind is Kind.SAMPLE and self._sample.state is LegacyState.IDLE:
                self._sample = step

    def _begin(self, job: Job) -> tuple[Operation, Future[None]]:
        """Enqueue a step; return it, and what is done once every poll knows its end.

        Raises:
            QueueFullError: A step is under way, or too much waits.
        """
        with self._lock:
            if LegacyState.BUSY in (self._batch.state, self._sample.state):
                raise QueueFullError("a step is under way already: poll until it has finished")
            operation = self._operations.submit(job)
            before, busy = self._sample, Step(LegacyState.BUSY)
            if job.kind is Kind.BATCH:
                self._batch, self._sample = busy, Step()
            else:
                self._sample = busy
            return operation, self._follower.submit(self._follow, operation, before)

    def _follow(self, operation: Operation, sample_before: Step) -> None:
        """Wait for the end of a step and write its files before its state says that it ended.

        A sample that was refused leaves what the one before it brought.
        """
        try:
            step = Step(LegacyState.FINISHED, self._outcome(operation))
        except OaisysError as error:
            step = Step(LegacyState.FINISHED, error=error)
        except Exception as error:  # noqa: BLE001 - a state must not stay busy for ever
            _LOG.exception("a step failed in the server")
            failure = OaisysError(f"internal error: {type(error).__name__}: {error}")
            step = Step(LegacyState.FINISHED, error=failure)
        if step.error is not None:
            _LOG.warning("%s: %s", operation.job.method, step.error)
        with self._lock:
            if operation.job.kind is Kind.BATCH:
                self._batch = step
            elif step.error is not None and sample_before.files and _waits(operation.status):
                self._sample = sample_before
            else:
                self._sample = step

    def _outcome(self, operation: Operation) -> Sequence[str]:
        for _ in operation.changes(threading.Event()):
            pass
        status = operation.status
        if status.error is not None:
            raise status.error
        if operation.job.kind is Kind.BATCH:
            return ()
        messages = self._operations.samples.get(status.batch_id, status.sample_id)
        sample = sample_from_messages(messages)
        info = self._supervisor.info
        cameras = [sensor.name for sensor in info.sensors]
        return self._files.write(sample, cameras, info.semantic_labels)

    def _await_sample(
        self, operation: Operation, followed: Future[None], context: Context
    ) -> tuple[int, int]:
        """Wait until a sample has begun; return its batch and sample id.

        Raises:
            OaisysError: It was refused, or has failed already.
        """
        gone = threading.Event()
        context.add_callback(gone.set)
        for event in operation.events(gone):
            if isinstance(event, SampleMessages):
                return event.batch_id, event.sample_id
        status = operation.status
        if status.error is not None:
            wait([followed])
            raise status.error
        return status.batch_id, status.sample_id


def _waits(status: OperationStatus) -> bool:
    return status.progress.stage in _NOT_ADMITTED


def rig_pose_from_blender(message: pb.SensorModuleRequest.PoseType) -> Pose:
    """Return where the rig is when the original's sensor base is at a pose.

    The base has the axes of Blender's camera, so that a camera without a mount looks along the
    base's -z with y up; ``base_link`` looks along its x with z up. As in Blender, a quaternion of
    any length is a rotation; zeros are a half turn about x.

    Args:
        message: Pose of the sensor base in Blender's world.

    Raises:
        InvalidInputError: A number is not finite.
    """
    position_m = (message.x, message.y, message.z)
    quat_wxyz = (message.q_w, message.q_x, message.q_y, message.q_z)
    for name, numbers in (("position", position_m), ("orientation", quat_wxyz)):
        if not all(map(isfinite, numbers)):
            path = f"sensorModuleRequest.pose.{name}"
            raise InvalidInputError(path, list(numbers), "finite numbers")
    return rig_pose((*position_m, *quat_wxyz))


def _tell(context: Context, error: OaisysError) -> None:
    """Send the reason in the trailing metadata."""
    forget_frames(error)
    context.set_trailing_metadata(((ERROR_KEY, printable(str(error))),))
