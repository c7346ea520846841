"""The one hierarchy of errors that the simulator raises on purpose."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def nearest(received: object, names: Iterable[str]) -> str | None:
    """Return the name that was probably meant, None where none is near."""
    found = get_close_matches(str(received), list(names), n=1)
    return found[0] if found else None


def one_of(names: Iterable[str], received: object) -> str:
    """Return what follows "expected" where a name is none of those that there are."""
    known = sorted(names)
    near = nearest(received, known)
    hint = f" (did you mean {near}?)" if near is not None else ""
    return f"one of {', '.join(known) or 'none: none is installed'}{hint}"


class OaisysError(Exception):
    """Base of every error that this project raises on purpose."""


class InvalidInputError(OaisysError):
    """A value from outside is refused; nothing has changed.

    Attributes:
        field: Path of the offending field, such as ``sensors.0.width_px``.
        received: The value as it came.
        expected: What would have been accepted, in words.
    """

    def __init__(self, field: str, received: object, expected: str) -> None:
        super().__init__(f"{field}: received {received!r}, expected {expected}")
        self.field = field
        self.received = received
        self.expected = expected


class ConfigError(OaisysError):
    """A configuration cannot be used; the message has one line per fault, each with its path."""


class NotReadyError(OaisysError):
    """The call needs a state that has not been reached, such as a first batch."""


class NotFoundError(OaisysError):
    """A named thing (an operation, a sample, a sensor) does not exist or is gone."""


class QueueFullError(OaisysError):
    """Too many requests are waiting; try again later."""


class BackendUnavailableError(OaisysError):
    """The chosen backend cannot run here, for instance because ``bpy`` is not installed."""


class RenderError(OaisysError):
    """The backend failed to build a scene or to render it."""


class WorkerLostError(OaisysError):
    """The worker process died or was ended while it worked on the call."""


class DeadlineExceededError(OaisysError):
    """The call did not end within its deadline."""


class CancelledError(OaisysError):
    """The call was cancelled by its owner, or overtaken by a newer batch."""
