"""The errors that the simulator raises on purpose, in one hierarchy."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def nearest(received: object, names: Iterable[str]) -> str | None:
    """Return the name that was probably meant, or None if none is similar."""
    known = list(names)
    # A key without its unit, such as fx, may be too short to be similar.
    found = get_close_matches(str(received), known, n=1) or [
        name for name in known if name.startswith(f"{received}_")
    ]
    return found[0] if found else None


def one_of(names: Iterable[str], received: object) -> str:
    """Return the text after "expected" in the error about a name that does not exist."""
    known = sorted(names)
    return f"one of {', '.join(known) or 'none: none is installed'}{_hint(received, known)}"


def one_of_keys(keys: Iterable[str], received: object) -> str:
    """Return the text after "expected" in the error about a key that does not exist."""
    known = sorted(keys)
    if not known:
        return "no key at all"
    return f"one of the keys {', '.join(known)}{_hint(received, known)}"


def _hint(received: object, known: Iterable[str]) -> str:
    near = nearest(received, known)
    return f" (did you mean {near}?)" if near is not None else ""


class OaisysError(Exception):
    """Base of every error that this project raises on purpose."""


class InvalidInputError(OaisysError):
    """A value from outside was refused, and nothing was changed.

    Attributes:
        field: Path of the offending field, such as ``sensors.0.width_px``.
        received: The value that was given.
        expected: A description of what would have been accepted.
    """

    def __init__(self, field: str, received: object, expected: str) -> None:
        super().__init__(f"{field}: received {received!r}, expected {expected}")
        self.field = field
        self.received = received
        self.expected = expected


class ConfigError(OaisysError):
    """A configuration cannot be used; the message has one line per error, each with its path."""


class NotReadyError(OaisysError):
    """The call is not possible yet, for instance before the first batch."""


class NotFoundError(OaisysError):
    """The named operation, sample or sensor does not exist (any more)."""


class QueueFullError(OaisysError):
    """Too many requests are waiting; try again later."""


class BackendUnavailableError(OaisysError):
    """The chosen backend cannot run here, for instance because ``bpy`` is not installed."""


class RenderError(OaisysError):
    """The backend failed to build a scene or to render it."""


class WorkerLostError(OaisysError):
    """The worker process died or was stopped while it worked on the call."""


class DeadlineExceededError(OaisysError):
    """The call did not end within its deadline."""


class CancelledError(OaisysError):
    """The call was cancelled by its owner, or replaced by a newer batch."""
