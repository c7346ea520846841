"""The original's service, ``oaisys.Oaisys``, beside ours: step, poll, read files."""
# ruff: noqa: N802 - the contract names the calls

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import grpc

from oaisys_core import geometry
from oaisys_core.config.sections.sensors import PosePolicy
from oaisys_core.errors import OaisysError, QueueFullError
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
from oaisys_grpc.server.servicer import OPERATION_TIMEOUT_S
from oaisys_grpc.server.supervision.supervisor import Supervisor

_LOG = logging.getLogger(__name__)

LEGACY_SERVICE = pb.DESCRIPTOR.services_by_name["Oaisys"].full_name
ERROR_KEY = "oaisys-error"
"""Trailing metadata: why a step was refused or failed, for which the messages have no field."""

T_BLENDER_BASE = geometry.invert(geometry.T_LINK_OPTICAL @ geometry.T_OPTICAL_BLENDER)
"""Pose of ``base_link`` in the original's sensor base."""

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
    """The state of a step; a failed one is idle, with an error."""

    state: LegacyState = LegacyState.IDLE
    files: Sequence[str] = ()
    error: OaisysError | None = None


class LegacyServicer(oaisys_pb2_grpc.OaisysServicer):
    """Serves the original's clients; every method may run on any thread.

    One step at a time: while a batch or a sample of this service is under way, another one is
    refused, so that no call changes the pose or the files of another. The result of a step is kept
    until the next one is accepted.
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
                admits every pose, and its client polls for ever for a sample that was refused.
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
            _tell(context, error)
            return pb.StepBatchReply(successRet=False)
        return pb.StepBatchReply(successRet=True)

    def StepSample(self, request: pb.StepSampleRequest, context: Context) -> pb.StepSampleReply:
        """Enqueue a sample, unless a step is under way; answer once its pose was admitted."""
        try:
            metadata = metadata_to_proto(self._metadata(request))
            step = simulator_pb2.StepSampleRequest(metadata=metadata).SerializeToString()
            job = Job(Kind.SAMPLE, "step_sample", step, OPERATION_TIMEOUT_S)
            batch_id, sample_id = self._admitted(*self._begin(job), context)
        except OaisysError as error:
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
            sensor["pose"] = rig_pose_from_blender(request.sensorModuleRequest.pose)
        return ModuleMetadata(sensor=sensor)

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
            step = Step(error=error)
        except Exception as error:  # noqa: BLE001 - a state must not stay busy for ever
            _LOG.exception("a step failed in the server")
            step = Step(error=OaisysError(f"internal error: {type(error).__name__}: {error}"))
        if step.error is not None:
            _LOG.warning("%s: %s", operation.job.method, step.error)
        with self._lock:
            if operation.job.kind is Kind.BATCH:
                self._batch = step
            elif step.error is not None and _waits(operation.status):
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

    def _admitted(
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
    base's -z with y up; ``base_link`` looks along its x with z up.

    Args:
        message: Pose of the sensor base in Blender's world.

    Raises:
        InvalidInputError: A number is not finite, or it is no unit quaternion.
    """
    base = geometry.checked_pose(
        (message.x, message.y, message.z),
        (message.q_x, message.q_y, message.q_z, message.q_w),
        "sensorModuleRequest.pose",
    )
    return geometry.pose_from_matrix(geometry.pose_to_matrix(base) @ T_BLENDER_BASE)


def _tell(context: Context, error: OaisysError) -> None:
    """Send the reason in the trailing metadata."""
    forget_frames(error)
    context.set_trailing_metadata(((ERROR_KEY, printable(str(error))),))
