"""Writes what a command was asked for, and keeps the output of C libraries out of it."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import typer

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.folders import make_folder
from oaisys_core.files.whole_files import write_whole_text


def write_or_print(text: str, out: Path | None) -> None:
    """Write a text to a file as a whole, whose folder is made, or to standard output without one.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    if out is None:
        typer.echo(text, nl=False)
        return
    make_folder(out.parent)
    try:
        write_whole_text(out, text)
    except OSError as error:
        raise InvalidInputError("out", str(out), f"a file that can be written ({error})") from error


@contextmanager
def own_stdout() -> Iterator[None]:
    """Reserve standard output for Python; Blender 4.5, for example, prints a line for each tile.

    Output of libraries goes to standard error if debug logging is on, otherwise it is dropped.
    """
    sys.stdout.flush()
    shows_all = logging.getLogger().isEnabledFor(logging.DEBUG)
    target = os.dup(2) if shows_all else os.open(os.devnull, os.O_WRONLY)
    kept, python = os.dup(1), sys.stdout
    os.dup2(target, 1)
    os.close(target)
    sys.stdout = open(kept, "w", encoding="utf-8", buffering=1, closefd=False)  # noqa: SIM115
    try:
        yield
    finally:
        own, sys.stdout = sys.stdout, python
        try:
            _flush(own)
        finally:
            os.dup2(kept, 1)
            os.close(kept)


def _flush(stream: TextIO) -> None:
    """Flush a stream; where it takes no more, close it, so that nothing tries it again."""
    try:
        stream.flush()
    except OSError:
        with suppress(OSError):
            stream.close()
        raise
