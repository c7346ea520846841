"""Limits of requests, so that none makes a server allocate without bounds."""

from __future__ import annotations

from collections.abc import Sequence

from oaisys_core.errors import InvalidInputError

MAX_REQUEST_BYTES = 4 * 1024 * 1024
"""Of one request; a larger one is refused unread, with RESOURCE_EXHAUSTED."""

MAX_NAMES = 1000
"""Sensors or modalities in one request."""

MAX_ID_CHARACTERS = 256
"""Of a request's id, which is remembered after its operation has ended."""


def request_id_of(given: str) -> str:
    """Return the id that a client gave a request; empty where it gave none.

    Raises:
        InvalidInputError: It has more than `MAX_ID_CHARACTERS`.
    """
    if len(given) > MAX_ID_CHARACTERS:
        expected = f"at most {MAX_ID_CHARACTERS} characters"
        raise InvalidInputError("request_id", f"{len(given)} characters", expected)
    return given


def names(given: Sequence[str], field: str) -> tuple[str, ...]:
    """Return the names in a field of a request.

    Raises:
        InvalidInputError: There are more than `MAX_NAMES`.
    """
    if len(given) > MAX_NAMES:
        raise InvalidInputError(field, f"{len(given)} names", f"at most {MAX_NAMES}")
    return tuple(given)
