"""Numbers in text files: Python also takes 1_000 and digits of other scripts for numbers."""

from __future__ import annotations

LARGEST = 2**63 - 1
"""Largest number, such as a seed or an id, that is given by its digits."""


def float_of(text: str | bytes) -> float:
    """Return a number in the form that text files have.

    Raises:
        ValueError: It is none.

    >>> float_of("1e3")
    1000.0
    """
    check_digits(text)
    return float(text)


def int_of(text: str | bytes) -> int:
    """Return a whole number likewise."""
    check_digits(text)
    return int(text)


def whole_of(text: str) -> int | None:
    """Return the number from 0 to `LARGEST` that the digits of a text are; None for other texts.

    Python itself reads at most 4,300 digits, and raises `ValueError` on more.

    >>> whole_of("0012"), whole_of("-1"), whole_of("9" * 5000)
    (12, None, None)
    """
    if not (text.isascii() and text.isdecimal()) or len(text) > len(str(LARGEST)):
        return None
    number = int(text)
    return number if number <= LARGEST else None


def check_digits(text: str | bytes) -> None:
    """Raise `ValueError` if numbers that Python finds in a text are none in text files."""
    joint = b"_" if isinstance(text, bytes) else "_"
    if joint in text or not text.isascii():  # type: ignore[operator] # both are of one kind
        raise ValueError("a number has the digits 0 to 9, which nothing joins")
