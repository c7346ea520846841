"""The service's calls: a request comes in, a job is enqueued, its answer goes out."""
# ruff: noqa: N802 - the contract names the calls

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import version

import grpc
from google.protobuf.message import Message

from oaisys_core.errors import CancelledError, InvalidInputError, OaisysError
from oaisys_core.types import FrameName
from oaisys_grpc.contract.arrays import array_chunks
from oaisys_grpc.contract.connection_names import name_of
from oaisys_grpc.contract.drive_messages import poses_from_proto
from oaisys_grpc.contract.errors import REASON_KEY, printable
from oaisys_grpc.contract.operation import Kind, OperationStatus, State, status_to_proto
from oaisys_grpc.contract.sample_messages import SampleMessages
from oaisys_grpc.contract.shared_memory import AVAILABLE, Probe
from oaisys_grpc.contract.transfer import (
    Transfer,
    frame_response,
    grant,
    limits_message,
    location_to_proto,
    sample_to_parts,
    transfer_from_proto,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc
from oaisys_grpc.server.jobs.drives import DriveJobs, DriveWork, TrajectoryStore
from oaisys_grpc.server.jobs.height_fields import height_field
from oaisys_grpc.server.jobs.job import Job, Operation
from oaisys_grpc.server.jobs.queue import OperationQueue
from oaisys_grpc.server.jobs.requests import (
    drive_job,
    operation_timeout_s,
    remaining_s,
    sample_job,
    step_job,
)
from oaisys_grpc.server.limits.open_calls import when_over
from oaisys_grpc.server.supervision.supervisor import Supervisor
from oaisys_grpc.worker.protocol import WorkerMessage

STATUS_PATIENCE_S = 0.02
"""How long the status of a sample is held back; frames that come meanwhile replace it."""

MAX_POINTS = 100_000
"""Of one QueryHeight."""


Context = grpc.ServicerContext


def send_reason(context: Context, reason: OaisysError | None) -> None:
    """Send, after a call's answer, why no worker runs; None: one does."""
    if reason is not None:
        context.set_trailing_metadata(((REASON_KEY, printable(str(reason))),))


class SimulatorServicer(simulator_pb2_grpc.SimulatorServiceServicer):
    """Serves one simulator; every method may run on any thread.

    A method that raises an `OaisysError` ends its call with the error's status: see `GuardedCalls`.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        operations: OperationQueue,
        on_end: Callable[[], None],
        *,
        shared_memory: bool,
    ) -> None:
        """Keep what the methods use.

        Args:
            on_end: Called when a client ends the simulation; must return at once.
            shared_memory: Offer frames to clients on this machine through shared memory.
        """
        self._supervisor = supervisor
        self._operations = operations
        self._on_end = on_end
        self._trajectories = TrajectoryStore()
        self._probe = Probe.if_possible() if shared_memory and AVAILABLE else None

    def GetSimulatorInfo(
        self, request: pb.GetSimulatorInfoRequest, context: Context
    ) -> pb.GetSimulatorInfoResponse:
        """Answer with the worker's last info."""
        send_reason(context, self._supervisor.refusal)
        message = pb.GetSimulatorInfoResponse()
        message.CopyFrom(self._supervisor.info)
        message.server_version = version("oaisys_grpc")
        message.worker_restarts = self._supervisor.restarts
        message.worker_recycles = self._supervisor.recycles
        message.transfer_limits.CopyFrom(limits_message())
        if request.with_config:
            message.config_json = self._supervisor.config_json
        if self._probe is not None:
            message.shared_memory_probe.CopyFrom(location_to_proto(self._probe.location))
        return message

    def StepBatch(self, request: pb.StepBatchRequest, context: Context) -> pb.StepBatchResponse:
        """Enqueue a batch."""
        estimate_key = ("batch", request.reuse_stage)
        timeout_s = operation_timeout_s(request)
        job = step_job(Kind.BATCH, request, request, timeout_s, estimate_key, context)
        return pb.StepBatchResponse(operation=self._status(self._enqueue(job, context)))

    def StepSample(self, request: pb.StepSampleRequest, context: Context) -> pb.StepSampleResponse:
        """Enqueue a sample."""
        job = sample_job(request, operation_timeout_s(request), context)
        return pb.StepSampleResponse(operation=self._status(self._enqueue(job, context)))

    def GetOperation(self, request: pb.GetOperationRequest, _: Context) -> pb.GetOperationResponse:
        """Answer at once."""
        operation = self._operations.get(request.name)
        return pb.GetOperationResponse(operation=self._status(operation))

    def WatchOperation(
        self, request: pb.WatchOperationRequest, context: Context
    ) -> Iterator[pb.WatchOperationResponse]:
        """Send the status until the operation has ended."""
        operation = self._operations.get(request.name)
        for status in operation.changes(_gone(context)):
            yield pb.WatchOperationResponse(operation=self._status(operation, status))

    def CancelOperation(
        self, request: pb.CancelOperationRequest, _: Context
    ) -> pb.CancelOperationResponse:
        """Cancel, and answer with the status."""
        operation = self._operations.cancel(request.name)
        return pb.CancelOperationResponse(operation=self._status(operation))

    def GetSample(self, request: pb.GetSampleRequest, _: Context) -> Iterator[pb.GetSampleResponse]:
        """Send a recent sample."""
        sample = self._operations.samples.get(request.batch_id, request.sample_id)
        for part in sample_to_parts(sample, self._grant(request)):
            yield pb.GetSampleResponse(part=part)

    def GetFrame(self, request: pb.GetFrameRequest, _: Context) -> pb.GetFrameResponse:
        """Answer with one frame of a recent sample."""
        sample = self._operations.samples.get(request.batch_id, request.sample_id)
        name = FrameName(request.sensor, request.modality)
        return frame_response(sample, name, request.accepted_encodings)

    def RenderSample(
        self, request: pb.RenderSampleRequest, context: Context
    ) -> Iterator[pb.RenderSampleResponse]:
        """Enqueue a sample; send its progress, and its frames as soon as they are ready."""
        job = sample_job(request, remaining_s(context), context)
        with self._operations.follow(job) as operation:
            for event in self._render(operation, self._grant(request), _gone(context)):
                if isinstance(event, OperationStatus):
                    yield pb.RenderSampleResponse(operation=self._status(operation, event))
                else:
                    yield pb.RenderSampleResponse(part=event)

    def SetTrajectory(
        self, request: pb.SetTrajectoryRequest, context: Context
    ) -> pb.SetTrajectoryResponse:
        """Have the worker plan a trajectory, and keep it."""
        poses_from_proto(request.poses)
        planned = self._ask_worker("plan_trajectory", request, context)
        trajectory = self._trajectories.add(pb.Trajectory.FromString(planned.content))
        return pb.SetTrajectoryResponse(trajectory=trajectory)

    def Drive(self, request: pb.DriveRequest, context: Context) -> Iterator[pb.DriveResponse]:
        """Send what the sensors measure along a trajectory, one sample after the other."""
        # Without shared memory, gRPC's flow control stops a drive whose reader is slow.
        transfer = replace(self._grant(request), token=b"")
        gone = _gone(context)

        def ask(method: str, step: pb.DriveStep) -> bytes:
            return self._ask_worker(method, step, context).content

        def render(step: pb.DriveStep) -> Iterator[pb.SamplePart | OperationStatus]:
            job = drive_job(step, remaining_s(context), context)
            with self._operations.follow(job) as operation:
                yield from self._render(operation, transfer, gone)

        work = DriveWork(ask, render, gone)
        yield from DriveJobs(request, self._trajectories.get(request.trajectory), work).events()

    def GetGroundTruthMesh(
        self, request: pb.GetGroundTruthMeshRequest, context: Context
    ) -> Iterator[pb.GetGroundTruthMeshResponse]:
        """Ask the worker for the mesh and send it."""
        answer = self._ask_worker("ground_truth_mesh", request, context)
        yield pb.GetGroundTruthMeshResponse.FromString(answer.content)
        for index, data in enumerate(answer.arrays):
            for chunk in array_chunks(data, index):
                yield pb.GetGroundTruthMeshResponse(chunk=chunk)

    def GetHeightField(
        self, request: pb.GetHeightFieldRequest, context: Context
    ) -> Iterator[pb.GetHeightFieldResponse]:
        """Ask the worker for the heights of some cells at a time, and send them."""
        return height_field(request, lambda cells: self._ask_worker("height_cells", cells, context))

    def QueryHeight(
        self, request: pb.QueryHeightRequest, context: Context
    ) -> pb.QueryHeightResponse:
        """Ask the worker for heights."""
        count = len(request.points_m)
        if count % 3 or count > 3 * MAX_POINTS:
            expected = f"x, y, z of at most {MAX_POINTS} points"
            raise InvalidInputError("points_m", f"{count} numbers", expected)
        answer = self._ask_worker("query_height", request, context)
        return pb.QueryHeightResponse.FromString(answer.content)

    def ListObjects(
        self, request: pb.ListObjectsRequest, context: Context
    ) -> pb.ListObjectsResponse:
        """Ask the worker for objects of the world."""
        answer = self._ask_worker("list_objects", request, context)
        return pb.ListObjectsResponse.FromString(answer.content)

    def EndSimulation(self, *_: object) -> pb.EndSimulationResponse:
        """Answer, and end the server."""
        self._on_end()
        return pb.EndSimulationResponse()

    def _enqueue(self, job: Job, context: Context) -> Operation:
        """Enqueue a job that its caller will ask for by name, unless the call is over by then.

        Nobody would know the name of such an operation, which others would wait for: of many calls
        at once, the server learns of some only after they were cancelled.

        Raises:
            CancelledError: The call is over.
        """
        if not context.is_active():
            raise CancelledError("the caller dropped the call")
        operation = self._operations.submit(job)
        if not context.is_active():
            operation.stop(CancelledError("the caller dropped the call"))
        return operation

    def _render(
        self, operation: Operation, transfer: Transfer, gone: threading.Event
    ) -> Iterator[pb.SamplePart | OperationStatus]:
        """Yield the parts of a sample as soon as they are ready, and its status until its end.

        The operation must be followed.

        Raises:
            OaisysError: The operation failed.
        """
        is_complete = False
        for event in operation.events(gone, STATUS_PATIENCE_S):
            if isinstance(event, SampleMessages):
                yield from sample_to_parts(event, transfer)
                is_complete = event.end is not None
            elif not event.state.is_final:
                yield event
        status = operation.status
        if status.error is not None:
            raise status.error
        if status.state is State.SUCCEEDED and not is_complete:  # an earlier request made it
            sample = self._operations.samples.get(status.batch_id, status.sample_id)
            yield from sample_to_parts(sample, transfer)

    def _grant(
        self, request: pb.GetSampleRequest | pb.RenderSampleRequest | pb.DriveRequest
    ) -> Transfer:
        return grant(transfer_from_proto(request.transfer), self._probe)

    def _ask_worker(self, method: str, request: Message, context: Context) -> WorkerMessage:
        """Enqueue a question, wait, and return the worker's answer."""
        content = request.SerializeToString()
        job = Job(None, method, content, remaining_s(context), peer=name_of(context))
        with self._operations.follow(job) as operation:
            for _ in operation.changes(_gone(context)):
                pass
        status = operation.status
        if status.error is not None:
            raise status.error
        assert operation.reply is not None
        return operation.reply

    def _status(self, operation: Operation, status: OperationStatus | None = None) -> pb.Operation:
        return status_to_proto(self._operations.with_times(operation, status or operation.status))


def _gone(context: Context) -> threading.Event:
    """Return an event that is set when the call has ended, for whatever reason."""
    gone = threading.Event()
    when_over(context, gone.set)
    return gone
