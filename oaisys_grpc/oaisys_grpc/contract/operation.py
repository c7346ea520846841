"""The status of an operation, and its message."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from oaisys_core.errors import OaisysError
from oaisys_core.types import Progress
from oaisys_grpc.contract.errors import code_of
from oaisys_grpc.contract.faults import Fault, error_from_fault, fault_from_error
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb


class Kind(Enum):
    """What an operation produces."""

    BATCH = pb.OPERATION_KIND_BATCH
    SAMPLE = pb.OPERATION_KIND_SAMPLE


class State(Enum):
    """The state of an operation."""

    QUEUED = pb.OPERATION_STATE_QUEUED
    RUNNING = pb.OPERATION_STATE_RUNNING
    SUCCEEDED = pb.OPERATION_STATE_SUCCEEDED
    FAILED = pb.OPERATION_STATE_FAILED
    CANCELLED = pb.OPERATION_STATE_CANCELLED

    @property
    def ended(self) -> bool:
        """Whether the state is final."""
        return self not in (State.QUEUED, State.RUNNING)


@dataclass(frozen=True)
class OperationStatus:
    """The status of an operation.

    Attributes:
        name: Unique among the operations of all servers.
        error: Why it failed or was cancelled.
        batch_id, sample_id: The result, once it succeeded; a batch has sample id 0.
    """

    name: str
    kind: Kind
    state: State = State.QUEUED
    progress: Progress = field(default_factory=lambda: Progress("queued", 0.0))
    error: OaisysError | None = None
    batch_id: int = 0
    sample_id: int = 0


def status_to_proto(status: OperationStatus) -> pb.Operation:
    """Return the message of a status; inverse: `status_from_proto`."""
    message = pb.Operation(
        name=status.name,
        kind=status.kind.value,
        state=status.state.value,
        progress=progress_to_proto(status.progress),
        batch_id=status.batch_id,
        sample_id=status.sample_id,
    )
    if status.error is not None:
        fault = fault_from_error(status.error)
        code, _ = code_of(fault.reason).value
        message.error.CopyFrom(pb.OperationError(code=code, **vars(fault)))
    return message


def status_from_proto(message: pb.Operation) -> OperationStatus:
    """Return a status."""
    error = message.error
    return OperationStatus(
        name=message.name,
        kind=Kind(message.kind),
        state=State(message.state),
        progress=progress_from_proto(message.progress),
        error=error_from_fault(_fault(error)) if message.HasField("error") else None,
        batch_id=message.batch_id,
        sample_id=message.sample_id,
    )


def _fault(message: pb.OperationError) -> Fault:
    return Fault(message.reason, message.message, message.field, message.received, message.expected)


def progress_to_proto(progress: Progress) -> pb.Progress:
    """Return the message of a progress; inverse: `progress_from_proto`."""
    return pb.Progress(
        stage=progress.stage, fraction=progress.fraction, seconds_left=progress.seconds_left
    )


def progress_from_proto(message: pb.Progress) -> Progress:
    """Return a progress."""
    left_s = message.seconds_left if message.HasField("seconds_left") else None
    return Progress(message.stage, message.fraction, left_s)
