"""From the requests of clients to jobs for the worker."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable

import grpc
from google.protobuf.message import Message

from oaisys_core.errors import InvalidInputError
from oaisys_grpc.contract.connection_names import name_of
from oaisys_grpc.contract.metadata import metadata_from_proto
from oaisys_grpc.contract.operation import Kind
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.server.jobs.job import Job

OPERATION_TIMEOUT_S = 600.0
"""For a job whose caller sets no limit, and the largest limit that a caller may set."""

MAX_ID_CHARACTERS = 256
"""Of a request's id, which is remembered after its operation has ended."""

Context = grpc.ServicerContext


def drive_job(step: pb.DriveStep, timeout_s: float, context: Context) -> Job:
    """Return the job of a sample of a drive."""
    content = step.SerializeToString()
    return Job(
        kind=Kind.SAMPLE,
        method="drive_sample",
        request=content,
        timeout_s=timeout_s,
        estimate_key=("drive", hash(tuple(step.due))),
        request_bytes=len(content),
        peer=name_of(context),
    )


StepRequest = pb.StepBatchRequest | pb.StepSampleRequest | pb.RenderSampleRequest


def sample_job(
    request: pb.StepSampleRequest | pb.RenderSampleRequest, timeout_s: float, context: Context
) -> Job:
    """Return the job of a sample; see `step_job`."""
    step = pb.StepSampleRequest(modalities=request.modalities, sensors=request.sensors)
    if request.HasField("metadata"):
        step.metadata.CopyFrom(request.metadata)
    quality = request.metadata.typed_render.quality
    estimate_key = ("sample", hash((*request.modalities, "", *request.sensors, "", quality)))
    return step_job(Kind.SAMPLE, request, step, timeout_s, estimate_key, context)


def step_job(
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
    if isinstance(step, pb.StepBatchRequest):  # what the worker need not know
        step = pb.StepBatchRequest.FromString(step.SerializeToString())
        step.ClearField("request_id")
        step.ClearField("timeout")
    return Job(
        kind=kind,
        method="step_batch" if kind is Kind.BATCH else "step_sample",
        request=step.SerializeToString(),
        timeout_s=timeout_s,
        request_id=request.request_id,
        body=_body(request),
        estimate_key=estimate_key,
        request_bytes=request.ByteSize(),
        peer=name_of(context),
    )


def _body(request: StepRequest) -> bytes:
    """Return a digest of a request, without how it is to be answered."""
    if isinstance(request, pb.RenderSampleRequest) and request.HasField("transfer"):
        asked, request = request, pb.RenderSampleRequest()
        request.CopyFrom(asked)
        request.ClearField("transfer")
    content = request.DESCRIPTOR.name.encode() + request.SerializeToString(deterministic=True)
    return hashlib.sha256(content).digest()


def operation_timeout_s(request: pb.StepBatchRequest | pb.StepSampleRequest) -> float:
    """Return how long the operation of a request may take.

    Raises:
        InvalidInputError: The request says 0 or less.
    """
    if not request.HasField("timeout"):
        return OPERATION_TIMEOUT_S
    timeout_s = request.timeout.seconds + request.timeout.nanos * 1e-9
    if timeout_s <= 0:
        raise InvalidInputError("timeout", timeout_s, "a positive time")
    return min(timeout_s, OPERATION_TIMEOUT_S)


def remaining_s(context: Context) -> float:
    """Return how long a call may still take."""
    left_s = context.time_remaining()
    return OPERATION_TIMEOUT_S if left_s is None else min(left_s, OPERATION_TIMEOUT_S)
