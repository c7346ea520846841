"""JSON texts of data sets, parsed; whatever is wrong with one is the same kind of error."""

from __future__ import annotations

from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json

SHOWN_CHARACTERS = 80
"""Characters of a refused text that an error shows."""


def parsed_json(text: str | bytes, name: str) -> Any:
    """Return the data of a JSON text; errors call it ``name``.

    Raises:
        InvalidInputError: It is no JSON, or beyond the bounds of `oaisys_core.files.documents`.
    """
    try:
        return parse_json(text)
    except ValueError as error:
        raise InvalidInputError(name, shortened(text), f"JSON ({error})") from error


def shortened(text: str | bytes) -> str:
    """Return the beginning of a text, for errors."""
    shown = text[:SHOWN_CHARACTERS]
    return shown if isinstance(shown, str) else shown.decode("utf-8", "replace")
