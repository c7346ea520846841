"""The one map between the simulator's errors and gRPC statuses."""

from __future__ import annotations

import re
from typing import Any, NoReturn

import grpc
from google.protobuf.any_pb2 import Any as AnyMessage
from google.protobuf.message import Message
from google.rpc.error_details_pb2 import BadRequest, ErrorInfo, PreconditionFailure, RetryInfo
from google.rpc.status_pb2 import Status
from grpc_status import rpc_status

from oaisys_core.errors import (
    BackendUnavailableError,
    CancelledError,
    ConfigError,
    DeadlineExceededError,
    InvalidInputError,
    NotFoundError,
    NotReadyError,
    OaisysError,
    QueueFullError,
    RenderError,
    ShortageError,
    WorkerLostError,
    WorkerStartingError,
)
from oaisys_grpc.contract.connection_advice import advice
from oaisys_grpc.contract.faults import (
    ERROR_TYPES,
    DeadlyRequestError,
    Fault,
    OvertakenError,
    ServerUnavailableError,
    UnknownTrajectoryError,
    error_from_fault,
    fault_from_error,
)

REASON_KEY = "oaisys-reason"
"""Trailing metadata of health's ``Check`` and of GetSimulatorInfo where no worker runs."""

DOMAIN = "oaisys"
"""Domain of the `ErrorInfo` that names an error."""

STATUS_CODES: dict[type[OaisysError], grpc.StatusCode] = {
    InvalidInputError: grpc.StatusCode.INVALID_ARGUMENT,
    ConfigError: grpc.StatusCode.INVALID_ARGUMENT,
    NotReadyError: grpc.StatusCode.FAILED_PRECONDITION,
    WorkerStartingError: grpc.StatusCode.FAILED_PRECONDITION,
    NotFoundError: grpc.StatusCode.NOT_FOUND,
    UnknownTrajectoryError: grpc.StatusCode.NOT_FOUND,
    QueueFullError: grpc.StatusCode.RESOURCE_EXHAUSTED,
    ShortageError: grpc.StatusCode.RESOURCE_EXHAUSTED,
    BackendUnavailableError: grpc.StatusCode.FAILED_PRECONDITION,
    DeadlyRequestError: grpc.StatusCode.FAILED_PRECONDITION,
    RenderError: grpc.StatusCode.INTERNAL,
    WorkerLostError: grpc.StatusCode.ABORTED,
    OvertakenError: grpc.StatusCode.ABORTED,
    DeadlineExceededError: grpc.StatusCode.DEADLINE_EXCEEDED,
    CancelledError: grpc.StatusCode.CANCELLED,
    ServerUnavailableError: grpc.StatusCode.UNAVAILABLE,
    OaisysError: grpc.StatusCode.INTERNAL,
}

RETRY_DELAYS_S: dict[type[OaisysError], float] = {
    QueueFullError: 1.0,
    WorkerLostError: 0.5,
    ServerUnavailableError: 1.0,
}
"""Temporary errors, and after how long to try again."""

_LONGEST_HEADER = 1000

_TOO_LARGE = re.compile(r"(?:SERVER: )?Received message larger than max \((\d+) vs\. (\d+)\)")
"""What gRPC says of a request that is larger than the server takes."""

_ERRORS_WITHOUT_NAME: dict[grpc.StatusCode, type[OaisysError]] = {
    grpc.StatusCode.FAILED_PRECONDITION: NotReadyError,
    grpc.StatusCode.NOT_FOUND: NotFoundError,
    grpc.StatusCode.RESOURCE_EXHAUSTED: QueueFullError,
    grpc.StatusCode.ABORTED: WorkerLostError,
    grpc.StatusCode.DEADLINE_EXCEEDED: DeadlineExceededError,
    grpc.StatusCode.CANCELLED: CancelledError,
    grpc.StatusCode.UNAVAILABLE: ServerUnavailableError,
}
"""Errors for statuses without `ErrorInfo`, which gRPC itself or a proxy made."""


def code_of(reason: str) -> grpc.StatusCode:
    """Return the status code of an error by its name."""
    return STATUS_CODES[ERROR_TYPES.get(reason, OaisysError)]


def status_from_error(error: OaisysError) -> Status:
    """Return the ``google.rpc.Status`` of an error; inverse: `error_from_status`."""
    fault = fault_from_error(error)
    info = ErrorInfo(domain=DOMAIN, reason=fault.reason)
    details: list[Message] = [info]
    if fault.field:
        info.metadata.update(received=fault.received, expected=fault.expected)
        violation = BadRequest.FieldViolation(field=fault.field, description=fault.message)
        details.append(BadRequest(field_violations=[violation]))
    status_code = code_of(fault.reason)
    if status_code is grpc.StatusCode.FAILED_PRECONDITION:
        unmet = PreconditionFailure.Violation(type=fault.reason, description=fault.message)
        details.append(PreconditionFailure(violations=[unmet]))
    delay_s = RETRY_DELAYS_S.get(ERROR_TYPES.get(fault.reason, OaisysError))
    if delay_s is not None:
        retry = RetryInfo()
        retry.retry_delay.FromMilliseconds(int(1000 * delay_s))
        details.append(retry)
    code, _ = status_code.value
    return Status(code=code, message=fault.message, details=[_pack(d) for d in details])


def error_from_status(status: Status) -> OaisysError | None:
    """Return the error that a status names; None if it names none of ours."""
    info, request = ErrorInfo(), BadRequest()
    for detail in status.details:
        detail.Unpack(info)
        detail.Unpack(request)
    if info.domain != DOMAIN:
        return None
    violations = request.field_violations
    return error_from_fault(
        Fault(
            reason=info.reason,
            message=status.message,
            field=violations[0].field if violations else "",
            received=info.metadata.get("received", ""),
            expected=info.metadata.get("expected", ""),
        )
    )


def abort(context: grpc.ServicerContext, error: OaisysError) -> NoReturn:
    """End a call with the status of an error."""
    forget_frames(error)
    context.abort_with_status(rpc_status.to_status(status_from_error(error)))
    raise AssertionError("abort_with_status returned")


def forget_frames(error: OaisysError) -> None:
    """Drop the traceback of an error that was sent to a client.

    An operation keeps its error, and the traceback's frames would keep the call: gRPC counts it
    among the open streams of its connection until the garbage collector comes by.
    """
    error.__traceback__ = None


def printable(text: str) -> str:
    """Return a text as a header may hold it: one line of printable ASCII, not too long."""
    escaped = text.encode("ascii", "backslashreplace").decode()
    return "".join(c if c.isprintable() else " " for c in escaped)[:_LONGEST_HEADER]


def error_from_rpc(error: grpc.RpcError) -> OaisysError:
    """Return what a failed call means to its caller."""
    call: Any = error  # every error that a call raises is a grpc.Call too, which its type hides
    status = rpc_status.from_call(call)
    named = error_from_status(status) if status is not None else None
    if named is not None:
        return named
    too_large = _TOO_LARGE.match(call.details() or "")
    if too_large is not None and call.code() is grpc.StatusCode.RESOURCE_EXHAUSTED:
        size, most = too_large.groups()
        return InvalidInputError("request", f"{size} bytes", f"at most {most} bytes")
    kind = _ERRORS_WITHOUT_NAME.get(call.code(), OaisysError)
    said, told = f"{call.code().name}: {call.details()}", advice(call.details() or "")
    return kind(f"{told} ({said})" if told else said)


def _pack(detail: Message) -> AnyMessage:
    packed = AnyMessage()
    packed.Pack(detail)
    return packed
