"""The service's calls: a request comes in, a job is enqueued, its answer goes out."""
# ruff: noqa: N802 - the contract names the calls

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Hashable, Iterator
from importlib.metadata import version
from typing import Any

import grpc
from google.protobuf.message import Message

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.types import FrameName
from oaisys_grpc.contract.arrays import array_chunks
from oaisys_grpc.contract.errors import printable
from oaisys_grpc.contract.metadata import metadata_from_proto
from oaisys_grpc.contract.operation import Kind, OperationStatus, State, status_to_proto
from oaisys_grpc.contract.sample_messages import SampleMessages
from oaisys_grpc.contract.shared_memory import AVAILABLE, Probe
from oaisys_grpc.contract.transfer import (
    Transfer,
    frame_response,
    granted,
    limits_message,
    place_to_proto,
    sample_to_parts,
    transfer_from_proto,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc
from oaisys_grpc.server.jobs.job import Job, Operation
from oaisys_grpc.server.jobs.queue import OperationQueue
from oaisys_grpc.server.limits.open_calls import when_over
from oaisys_grpc.server.supervision.supervisor import Supervisor
from oaisys_grpc.worker.protocol import WorkerMessage

OPERATION_TIMEOUT_S = 600.0
"""For a job whose caller sets no limit, and the largest limit that a caller may set."""

STATUS_PATIENCE_S = 0.02
"""How long the status of a sample is held back; frames that come meanwhile replace it."""

MAX_POINTS = 100_000
"""Of one QueryHeight."""

MAX_ID_CHARACTERS = 256
"""Of a request's id, which is remembered after its operation has ended."""

REASON_KEY = "oaisys-reason"
"""Trailing metadata of health's ``Check`` and of GetSimulatorInfo where no worker runs."""

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
        self._probe = Probe() if shared_memory and AVAILABLE else None

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
            message.shared_memory_probe.CopyFrom(place_to_proto(self._probe.place))
        return message

    def StepBatch(self, request: pb.StepBatchRequest, context: Context) -> pb.StepBatchResponse:
        """Enqueue a batch."""
        estimate_key = ("batch", request.reuse_stage)
        timeout_s = _operation_timeout_s(request)
        job = _step_job(Kind.BATCH, request, request, timeout_s, estimate_key, context)
        return pb.StepBatchResponse(operation=self._status(self._operations.submit(job)))

    def StepSample(self, request: pb.StepSampleRequest, context: Context) -> pb.StepSampleResponse:
        """Enqueue a sample."""
        job = _sample_job(request, _operation_timeout_s(request), context)
        return pb.StepSampleResponse(operation=self._status(self._operations.submit(job)))

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
        for part in sample_to_parts(sample, self._granted(request)):
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
        operation = self._operations.submit(_sample_job(request, _remaining_s(context), context))
        transfer = self._granted(request)
        is_complete = False
        with operation.followed():
            for event in operation.events(_gone(context), STATUS_PATIENCE_S):
                if isinstance(event, SampleMessages):
                    for part in sample_to_parts(event, transfer):
                        yield pb.RenderSampleResponse(part=part)
                    is_complete = event.end is not None
                elif not event.state.ended:
                    yield pb.RenderSampleResponse(operation=self._status(operation, event))
            status = operation.status
        if status.error is not None:
            raise status.error
        if status.state is State.SUCCEEDED and not is_complete:  # an earlier request made it
            sample = self._operations.samples.get(status.batch_id, status.sample_id)
            for part in sample_to_parts(sample, transfer):
                yield pb.RenderSampleResponse(part=part)

    def GetGroundTruthMesh(
        self, request: pb.GetGroundTruthMeshRequest, context: Context
    ) -> Iterator[pb.GetGroundTruthMeshResponse]:
        """Ask the worker for the mesh and send it."""
        return self._in_chunks(pb.GetGroundTruthMeshResponse, "ground_truth_mesh", request, context)

    def GetHeightField(
        self, request: pb.GetHeightFieldRequest, context: Context
    ) -> Iterator[pb.GetHeightFieldResponse]:
        """Ask the worker for the heights and send them."""
        return self._in_chunks(pb.GetHeightFieldResponse, "height_grid", request, context)

    def QueryHeight(
        self, request: pb.QueryHeightRequest, context: Context
    ) -> pb.QueryHeightResponse:
        """Ask the worker for heights."""
        count = len(request.points_m)
        if count % 3 or count > 3 * MAX_POINTS:
            expected = f"x, y, z of at most {MAX_POINTS} points"
            raise InvalidInputError("points_m", f"{count} numbers", expected)
        answer = self._asked("query_height", request, context)
        return pb.QueryHeightResponse.FromString(answer.content)

    def ListObjects(
        self, request: pb.ListObjectsRequest, context: Context
    ) -> pb.ListObjectsResponse:
        """Ask the worker for objects of the world."""
        answer = self._asked("list_objects", request, context)
        return pb.ListObjectsResponse.FromString(answer.content)

    def EndSimulation(self, *_: object) -> pb.EndSimulationResponse:
        """Answer, and end the server."""
        self._on_end()
        return pb.EndSimulationResponse()

    def _granted(self, request: pb.GetSampleRequest | pb.RenderSampleRequest) -> Transfer:
        return granted(transfer_from_proto(request.transfer), self._probe)

    def _asked(self, method: str, request: Message, context: Context) -> WorkerMessage:
        """Enqueue a question, wait, and return the worker's answer."""
        content = request.SerializeToString()
        job = Job(None, method, content, _remaining_s(context), peer=context.peer())
        operation = self._operations.submit(job)
        with operation.followed():
            for _ in operation.changes(_gone(context)):
                pass
        status = operation.status
        if status.error is not None:
            raise status.error
        assert operation.reply is not None
        return operation.reply

    def _in_chunks(
        self, response: Any, method: str, request: Message, context: Context
    ) -> Iterator[Any]:
        """Ask the worker for arrays; yield messages with their header and then their chunks."""
        answer = self._asked(method, request, context)
        yield response.FromString(answer.content)
        for index, data in enumerate(answer.arrays):
            for chunk in array_chunks(data, index):
                yield response(chunk=chunk)

    def _status(self, operation: Operation, status: OperationStatus | None = None) -> pb.Operation:
        return status_to_proto(self._operations.timed(operation, status or operation.status))


StepRequest = pb.StepBatchRequest | pb.StepSampleRequest | pb.RenderSampleRequest


def _sample_job(
    request: pb.StepSampleRequest | pb.RenderSampleRequest, timeout_s: float, context: Context
) -> Job:
    step = pb.StepSampleRequest(modalities=request.modalities, sensors=request.sensors)
    if request.HasField("metadata"):
        step.metadata.CopyFrom(request.metadata)
    quality = request.metadata.typed_render.quality
    estimate_key = ("sample", hash((*request.modalities, "", *request.sensors, "", quality)))
    return _step_job(Kind.SAMPLE, request, step, timeout_s, estimate_key, context)


def _step_job(
    kind: Kind,
    request: StepRequest,
    step: Message,
    timeout_s: float,
    estimate_key: Hashable,
    context: Context,
) -> Job:
    """Return the job of a request; ``step`` is the message for the worker.

    Raises:
        InvalidInputError: The id is too long, or the metadata cannot be read: they are refused
            before anything is enqueued or overtaken.
    """
    if len(request.request_id) > MAX_ID_CHARACTERS:
        received = f"{len(request.request_id)} characters"
        raise InvalidInputError("request_id", received, f"at most {MAX_ID_CHARACTERS}")
    if request.HasField("metadata"):
        metadata_from_proto(request.metadata)
    return Job(
        kind=kind,
        method="step_batch" if kind is Kind.BATCH else "step_sample",
        request=step.SerializeToString(),
        timeout_s=timeout_s,
        request_id=request.request_id,
        body=_body(request),
        estimate_key=estimate_key,
        request_bytes=request.ByteSize(),
        peer=context.peer(),
    )


def _body(request: StepRequest) -> bytes:
    """Return a digest of a request, without how it is to be answered."""
    if isinstance(request, pb.RenderSampleRequest) and request.HasField("transfer"):
        asked, request = request, pb.RenderSampleRequest()
        request.CopyFrom(asked)
        request.ClearField("transfer")
    content = request.DESCRIPTOR.name.encode() + request.SerializeToString(deterministic=True)
    return hashlib.sha256(content).digest()


def _operation_timeout_s(request: pb.StepBatchRequest | pb.StepSampleRequest) -> float:
    if not request.HasField("timeout"):
        return OPERATION_TIMEOUT_S
    timeout_s = request.timeout.seconds + request.timeout.nanos * 1e-9
    if timeout_s <= 0:
        raise InvalidInputError("timeout", timeout_s, "a positive time")
    return min(timeout_s, OPERATION_TIMEOUT_S)


def _remaining_s(context: Context) -> float:
    remaining_s = context.time_remaining()
    return OPERATION_TIMEOUT_S if remaining_s is None else min(remaining_s, OPERATION_TIMEOUT_S)


def _gone(context: Context) -> threading.Event:
    """Return an event that is set when the call has ended, for whatever reason."""
    gone = threading.Event()
    when_over(context, gone.set)
    return gone
