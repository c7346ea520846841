"""JSON and plain text from outside, within bounds of size, nesting and repetition."""

from __future__ import annotations

import codecs
import json
import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from oaisys_core.errors import quote, show_field

MAX_TEXT_BYTES = 4_000_000
"""Size of a YAML or JSON file that a person may have written."""

MAX_VALUES = 500_000
"""Values in a YAML document after each alias is replaced by what it stands for."""

LONGEST_WHOLE = 256
"""Characters of a whole number, of base 10 or 16, up to which it can be a float."""

MAX_DEPTH = 64
"""Lists and mappings inside of each other, aliases followed."""

_WIDE = {
    codecs.BOM_UTF32_LE: "UTF-32",  # begins like UTF-16
    codecs.BOM_UTF32_BE: "UTF-32",
    codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}
"""Encodings by the mark that a file begins with, longer marks first."""


class DocumentError(ValueError):
    """A document cannot be read, or is larger or more nested than its bounds."""


def read_text(path: Path, most_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the text in a file.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no regular file, too large, or not UTF-8.
    """
    data = read_bytes(path, most_bytes)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        if (name := wide_encoding(data)) is not None:
            text = f"it is text in {name}, expected UTF-8: save it as that"
            raise DocumentError(text) from None
        found = f"byte 0x{data[error.start]:02x} at position {error.start}"
        raise DocumentError(f"it is not text in UTF-8: {found}") from None


def wide_encoding(data: bytes) -> str | None:
    """Return the encoding whose mark a text begins with: UTF-16, UTF-32, or None of them."""
    return next((name for mark, name in _WIDE.items() if data.startswith(mark)), None)


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Return the content of a regular file of at most ``most_bytes``.

    Raises:
        OSError: It cannot be read.
        DocumentError: It is no regular file, such as a pipe that never ends, or it is too large.
    """
    with open_regular(path, most_bytes) as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise DocumentError(f"it has more than {most_bytes} bytes")
    return data


@contextmanager
def open_regular(path: Path, most_bytes: int) -> Iterator[BinaryIO]:
    """Open a regular file of at most ``most_bytes`` to read it.

    Raises:
        OSError: It cannot be opened.
        DocumentError: It is no regular file, such as a pipe that never ends, or it is too large.
    """
    # Opening a pipe would wait for its writer.
    with open(path, "rb", opener=_open_without_waiting) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise DocumentError("it is not a regular file")
        if status.st_size > most_bytes:
            raise DocumentError(f"it has {status.st_size} bytes, more than {most_bytes}")
        yield file


def _open_without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)


def parse_json(text: str | bytes) -> Any:
    """Return the data in a JSON text.

    Raises:
        ValueError: It is not JSON, has a key twice, a whole number that no float can be, or is
            nested more than `MAX_DEPTH` times.
    """
    huge: list[_Digits] = []

    def whole(digits: str) -> int | _Digits:
        if len(digits) <= LONGEST_WHOLE or math.isfinite(float(digits)):
            return int(digits)
        huge.append(_Digits(digits))
        return huge[-1]

    try:
        data = json.loads(text, object_pairs_hook=_without_repeats, parse_int=whole)
    except RecursionError:
        raise DocumentError(f"it is nested more than {MAX_DEPTH} times") from None
    # A text with fewer brackets than that cannot be nested deeper, and most have fewer.
    raw = text if isinstance(text, bytes) else text.encode(errors="replace")
    if raw.count(b"[") + raw.count(b"{") > MAX_DEPTH:
        _check_depth(data)
    if huge:
        _check_digits(data)
    return data


def parse_plain_json(text: str) -> Any:
    """Return the data in a JSON text that a program has sent, where nothing is ambiguous.

    Raises:
        DocumentError: It is not JSON, larger than `MAX_TEXT_BYTES`, nested too deep, has a key
            twice, a number that is not finite as a float, or a character that UTF-8 has not.
    """
    if len(text) > MAX_TEXT_BYTES:
        raise DocumentError(f"it has {len(text)} characters, more than {MAX_TEXT_BYTES}")
    if text.count("[") + text.count("{") > MAX_VALUES:
        raise DocumentError(f"it has more than {MAX_VALUES} values")
    try:
        data = json.loads(
            text,
            object_pairs_hook=_without_repeats,
            parse_constant=_finite,
            parse_float=_finite,
            parse_int=_whole,
        )
        json.dumps(data, ensure_ascii=False).encode()
    except RecursionError:
        raise DocumentError(f"it is nested more than {MAX_DEPTH} times") from None
    except ValueError as error:
        raise DocumentError(str(error)) from error
    _check_depth(data)
    return data


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise DocumentError(f"the key {quote(name)} stands there twice")
        found[name] = value
    return found


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise DocumentError(f"{quote(text)} is not a finite number")
    return number


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


class _Digits(str):
    """A whole number that no float can be."""

    __slots__ = ()


def _check_digits(data: Any) -> None:
    """Raise for the first whole number that no float can be, with its place."""
    left = [("", data)]
    while left:
        place, value = left.pop()
        if isinstance(value, _Digits):
            found = f"{len(value)} digits, {quote(str(value))}"
            expected = "a whole number that a float can be"
            raise DocumentError(
                f"{show_field(place[1:] or 'it')}: received {found}, expected {expected}"
            )
        if isinstance(value, dict):
            left += [(f"{place}.{key}", each) for key, each in reversed(value.items())]
        elif isinstance(value, list):
            left += [(f"{place}.{index}", value[index]) for index in reversed(range(len(value)))]


def _check_depth(data: Any) -> None:
    level, depth = [data], 0
    while level:
        depth += 1
        if depth > MAX_DEPTH + 1:
            raise DocumentError(f"it is nested more than {MAX_DEPTH} times")
        level = [
            each
            for value in level
            if isinstance(value, dict | list)
            for each in (value.values() if isinstance(value, dict) else value)
        ]
