"""The errors that the simulator raises on purpose, in one hierarchy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from itertools import chain, islice
from pathlib import PurePath

LONGEST_NAME = 100
"""Characters of a name for which similar ones are looked for; longer ones take too long."""

LONGEST_QUOTE = 80
"""Characters that an error shows of a value."""

LONGEST_FIELD = 200
"""Characters that an error shows of a field's path, which may have keys from outside."""

_MAX_BITS = 1024
"""Size of a whole number up to which its digits are computed, which takes time with its square."""


def quote(value: object) -> str:
    """Return the first 80 characters of a value's ``repr``; of a long path, begin and end.

    It takes no longer for a huge or nested value, and never fails.

    >>> quote(["a" * 100])
    "['aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa..."
    """
    text = "".join(islice(_characters(value, 0), LONGEST_QUOTE + 1))
    if len(text) <= LONGEST_QUOTE:
        return text
    if isinstance(value, str | PurePath) and (path := str(value)).startswith("/"):
        # The name of a file says more than the first of its folders.
        return f"{text[:20]}...{ascii(path[-54:])[1:]}"[-LONGEST_QUOTE:]
    return text[: LONGEST_QUOTE - 3] + "..."


def show_field(path: str) -> str:
    r"""Return the first characters of a field's path, those that may command a terminal escaped.

    >>> print(show_field("metadata.sensor.a\x1b[31m"))
    metadata.sensor.a\x1b[31m
    """
    shown = path if len(path) <= LONGEST_FIELD else f"{path[: LONGEST_FIELD - 3]}..."
    return _escape_unprintable(shown)


def one_line(text: str) -> str:
    r"""Return a text of others in one line, without characters that YAML, UTF-8 or a terminal lack.

    >>> print(one_line("a key\nseed: 1 \x1b[31m"))
    a key seed: 1 \x1b[31m
    """
    # str.split has all that YAML and str.splitlines take for the end of a line.
    return _escape_unprintable(" ".join(text.split()))


def _escape_unprintable(text: str) -> str:
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


def _characters(value: object, depth: int) -> Iterator[str]:
    """Yield the characters of a value's ``repr``, of long texts and numbers only the first."""
    if depth > LONGEST_QUOTE:
        yield from "..."
    elif isinstance(value, Mapping) and type(value).__module__ == "builtins":
        yield "{"
        for index, (key, each) in enumerate(value.items()):
            yield from ", " if index else ""
            yield from chain(_characters(key, depth + 1), ": ", _characters(each, depth + 1))
        yield "}"
    elif isinstance(value, list | tuple) and type(value) in (list, tuple):
        yield "[" if isinstance(value, list) else "("
        for index, each in enumerate(value):
            yield from ", " if index else ""
            yield from _characters(each, depth + 1)
        yield from ",)" if isinstance(value, tuple) and len(value) == 1 else ""
        yield from "]" if isinstance(value, list) else "" if len(value) == 1 else ")"
    else:
        yield from _short_repr(value)


def _short_repr(value: object) -> str:
    if isinstance(value, str | bytes | bytearray):
        return repr(value[: LONGEST_QUOTE + 1])
    if isinstance(value, int) and value.bit_length() > _MAX_BITS:
        return f"a whole number of {value.bit_length()} bits"
    try:
        return repr(value)
    except Exception as error:  # noqa: BLE001  # a value from outside
        return f"<{type(value).__name__}: {type(error).__name__}>"


def nearest(received: object, names: Iterable[str]) -> str | None:
    """Return the name that was probably meant, in whatever case, or None if none is similar."""
    if not isinstance(received, str) or len(received) > LONGEST_NAME:
        return None
    wanted, by_folded = received.casefold(), {name.casefold(): name for name in names}
    # A key without its unit, such as fx, may be too short to be similar.
    found = get_close_matches(wanted, by_folded, n=1) or [
        name for name in by_folded if name.startswith(f"{wanted}_")
    ]
    return by_folded[found[0]] if found else None


def did_you_mean(received: object, names: Iterable[str]) -> str:
    """Return a hint that ends the error about an unknown name; empty if no name is similar."""
    near = nearest(received, names)
    return "" if near in (None, received) else f" (did you mean {near}?)"


def one_of(names: Iterable[str], received: object) -> str:
    """Return the text after "expected" in the error about a name that does not exist."""
    known = sorted(names)
    return f"one of {', '.join(known) or 'none: there is none'}{did_you_mean(received, known)}"


def one_of_keys(keys: Iterable[str], received: object) -> str:
    """Return the text after "expected" in the error about a key that does not exist."""
    known = sorted(keys)
    if not known:
        return "no key at all"
    return f"one of the keys {', '.join(known)}{did_you_mean(received, known)}"


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
        super().__init__(f"{show_field(field)}: received {quote(received)}, expected {expected}")
        self.field = field
        self.received = received
        self.expected = expected


class ConfigError(OaisysError):
    """A configuration cannot be used; the message has one line per error, each with its path."""


class NotReadyError(OaisysError):
    """The call is not possible yet, for instance before the first batch."""


class WorkerStartingError(NotReadyError):
    """The simulator answers, but its worker is being started: it is worth waiting for."""


class NotFoundError(OaisysError):
    """The named operation, sample or sensor does not exist (any more)."""


class QueueFullError(OaisysError):
    """Too many requests are waiting; try again later."""


class ShortageError(OaisysError):
    """This process may not have more memory, threads or files."""


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
