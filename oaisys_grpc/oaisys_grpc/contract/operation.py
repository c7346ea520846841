"""The status of an operation, and its message."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from operator import attrgetter

from oaisys_core.errors import OaisysError
from oaisys_core.types import Progress
from oaisys_grpc.contract.conversion import Conversion, RecordConversion
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
    def is_final(self) -> bool:
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


def _error_to_proto(error: OaisysError) -> pb.OperationError:
    fault = fault_from_error(error)
    code, _ = code_of(fault.reason).value
    return pb.OperationError(code=code, **vars(fault))


def _error_from_proto(message: pb.OperationError) -> OaisysError:
    texts = (message.message, message.field, message.received, message.expected)
    return error_from_fault(Fault(message.reason, *texts))


_PROGRESS = RecordConversion(Progress, pb.Progress)
progress_to_proto, progress_from_proto = _PROGRESS.to_proto, _PROGRESS.from_proto

_STATUS = RecordConversion(
    OperationStatus,
    pb.Operation,
    kind=Conversion(attrgetter("value"), Kind),
    state=Conversion(attrgetter("value"), State),
    progress=_PROGRESS,
    error=Conversion(_error_to_proto, _error_from_proto),
)
status_to_proto, status_from_proto = _STATUS.to_proto, _STATUS.from_proto
