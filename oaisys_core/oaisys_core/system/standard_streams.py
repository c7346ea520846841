"""The three standard streams of a program, one of which its user may have closed (``>&-``)."""

from __future__ import annotations

import os
import sys


def open_standard_streams() -> None:
    """Open the standard streams that are closed, so that nothing is read from or written to them.

    Otherwise the next file or socket would get a stream's number, and what a library prints would
    be written into it. For the beginning of a program.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free, which is this
            os.set_inheritable(number, True)
    if sys.stdin is None:
        sys.stdin = open(0, closefd=False, encoding="utf-8")  # noqa: SIM115
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False, encoding="utf-8")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", closefd=False, encoding="utf-8")  # noqa: SIM115


def printable(text: str) -> str:
    """Return a text whose control characters, which may command a terminal, are escaped.

    Line breaks and tabs stay.
    """
    return "".join(
        each if each.isprintable() or each in "\n\t" else ascii(each)[1:-1] for each in text
    )
