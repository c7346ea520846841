"""What an error status carries beside its code and text: google.rpc's own messages."""

from __future__ import annotations

from typing import Any

import pytest
from google.rpc import code_pb2, error_details_pb2

from oaisys_core.errors import (
    InvalidInputError,
    NotReadyError,
    OaisysError,
    QueueFullError,
    WorkerLostError,
)
from oaisys_grpc.contract.errors import error_from_status, status_from_error
from oaisys_grpc.contract.faults import OvertakenError


def detail_of(error: OaisysError, kind: type[Any]) -> Any:
    message = kind()
    (found,) = [d for d in status_from_error(error).details if d.Is(kind.DESCRIPTOR)]
    found.Unpack(message)
    return message


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (QueueFullError("full"), code_pb2.RESOURCE_EXHAUSTED),
        (WorkerLostError("x"), code_pb2.ABORTED),
    ],
)
def test_what_passes_by_itself_says_when_to_ask_again(error: OaisysError, code: int) -> None:
    assert status_from_error(error).code == code
    retry = detail_of(error, error_details_pb2.RetryInfo)
    assert 0 < retry.retry_delay.ToMilliseconds() <= 5000
    assert detail_of(error, error_details_pb2.ErrorInfo).domain == "oaisys"


def test_what_does_not_pass_by_itself_says_nothing_of_asking_again() -> None:
    for error in (OvertakenError("newer"), InvalidInputError("pose", 1, "a pose")):
        kinds = [detail.TypeName() for detail in status_from_error(error).details]
        assert "google.rpc.RetryInfo" not in kinds


def test_a_refused_field_is_a_field_violation() -> None:
    error = InvalidInputError("metadata.render.samples", -1, "1 or more")
    (violation,) = detail_of(error, error_details_pb2.BadRequest).field_violations
    assert violation.field == "metadata.render.samples"
    assert "1 or more" in violation.description


def test_what_must_be_done_before_is_a_precondition() -> None:
    error = NotReadyError("there is no world yet")
    assert status_from_error(error).code == code_pb2.FAILED_PRECONDITION
    (violation,) = detail_of(error, error_details_pb2.PreconditionFailure).violations
    assert violation.type == "NotReadyError"
    assert "no world" in violation.description


@pytest.mark.parametrize(
    "received", ["x" * 3_900_000, [{}] * 50_000, {"kind": "x" * 1000}, 10**300, "/".join("/" * 900)]
)
def test_a_long_value_looks_the_same_however_far_its_error_travels(received: Any) -> None:
    """It was quoted anew by each process, until nothing but backslashes was left of it."""
    error: OaisysError | None = InvalidInputError("metadata.sensor.motion", received, "a mapping")
    first = str(error)
    for _ in range(3):
        assert error is not None
        error = error_from_status(status_from_error(error))
    assert str(error) == first


def test_keys_from_outside_neither_command_a_terminal_nor_cut_a_sentence_off() -> None:
    """ROS ends a text at its first NUL."""
    for key in ("a\x1b[31m\x00b", "\u202e", "k" * 1_000_000):
        error = error_from_status(status_from_error(InvalidInputError(f"metadata.{key}", 1, "no")))
        assert str(error).isprintable()
        assert len(str(error)) < 300
        assert str(error).endswith(": received 1, expected no")
