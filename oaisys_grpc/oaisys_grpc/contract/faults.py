"""Errors as plain data, so that they can pass between processes.

Must not import gRPC: the worker uses this module, too.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from oaisys_core import errors
from oaisys_core.errors import CancelledError, InvalidInputError, OaisysError, quote


class OvertakenError(CancelledError):
    """A newer batch was asked for while the sample waited or rendered."""


class DeadlyRequestError(OaisysError):
    """The same request has ended a worker before, and would probably end another one."""


class UnknownTrajectoryError(OaisysError):
    """A worker was given the name of a trajectory that it does not know, for instance a new one."""


class ServerUnavailableError(OaisysError):
    """No server answers at the address, or the connection broke."""


ERROR_TYPES: dict[str, type[OaisysError]] = {
    "DeadlyRequestError": DeadlyRequestError,
    "OvertakenError": OvertakenError,
    "ServerUnavailableError": ServerUnavailableError,
    "UnknownTrajectoryError": UnknownTrajectoryError,
    **{
        name: value
        for name, value in vars(errors).items()
        if isinstance(value, type) and issubclass(value, OaisysError)
    },
}
"""Errors that pass between processes, by name; any other passes as the nearest of its bases."""

LONGEST_TEXT = 800
"""Characters of each text: a status travels in headers of 8 KiB, and its texts more than once."""


@dataclass(frozen=True)
class Fault:
    """An `OaisysError` as data.

    Attributes:
        reason: Name of its class.
        field, received, expected: Those of an `InvalidInputError`, ``received`` as JSON; else "".
    """

    reason: str
    message: str
    field: str = ""
    received: str = ""
    expected: str = ""


@dataclass(frozen=True, repr=False)
class Excerpt:
    """What an error shows of a value that is too long to be sent; looks the same in errors.

    Attributes:
        text: As `quote` returned it.
    """

    text: str

    def __repr__(self) -> str:
        """Return the text as it is, so that it is not quoted again on its way."""
        return self.text


def fault_from_error(error: OaisysError) -> Fault:
    """Return the error as data; inverse: `error_from_fault`."""
    reason = next(c.__name__ for c in type(error).__mro__ if c.__name__ in ERROR_TYPES)
    if isinstance(error, InvalidInputError):
        received = _to_json(error.received)
        texts = (str(error), error.field, received, error.expected)
        return Fault(reason, *map(_cut, texts))
    return Fault(reason, _cut(str(error)))


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 3]}..."


def error_from_fault(fault: Fault) -> OaisysError:
    """Return an error of the class that the fault names; inverse: `fault_from_error`."""
    kind = ERROR_TYPES.get(fault.reason, OaisysError)
    if issubclass(kind, InvalidInputError):
        return InvalidInputError(fault.field, _from_json(fault.received), fault.expected)
    return kind(fault.message)


def _to_json(value: object) -> str:
    """Return a value as JSON; where that is impossible, or too long, what an error shows of it."""
    if isinstance(value, Excerpt):
        return value.text
    try:
        text = json.dumps(value)
    except (TypeError, ValueError):
        return json.dumps(repr(value))
    return text if len(text) <= LONGEST_TEXT else quote(value)


def _from_json(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return Excerpt(text)
