"""Keeps what C libraries write to a command's standard streams out of what it says there."""

from __future__ import annotations

import logging
import os
import secrets
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from oaisys_core.system.ending.last_words import say_if_ended
from oaisys_core.system.ending.leftovers import remove_when_killed

STREAMS = {"stdout": 1, "stderr": 2}
"""The file descriptor of each of Python's streams."""


@contextmanager
def keep_messages(prefix: str, sentence: str) -> Iterator[None]:
    """Keep what libraries write to standard output and error in a temporary file.

    The file is removed at the end, but for one case: a library ends this process within the block.
    Then the process that waits for this one says so, see `say_if_ended`.

    Args:
        prefix: How the name of the file begins.
        sentence: What is said; ``{log}`` in it becomes the path of the file.
    """
    log = Path(tempfile.gettempdir(), f"{prefix}{secrets.token_hex(4)}.log")
    said = sentence.format(log=log)
    with remove_when_killed(log):
        try:
            with own_streams(log), say_if_ended(said, log):
                yield
        finally:
            log.unlink(missing_ok=True)


@contextmanager
def own_streams(log: Path) -> Iterator[None]:
    """Reserve standard output and error for Python; what libraries write there goes to a file.

    Programs that are started within the block write to the file, too.

    Args:
        log: The file; what is written is appended.

    Raises:
        OSError: It cannot be opened.
    """
    target = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o600)
    try:
        with _own_stream("stdout", target), _own_stream("stderr", target):
            yield
    finally:
        os.close(target)


@contextmanager
def _own_stream(name: str, target: int) -> Iterator[None]:
    """Reserve a stream for Python; its descriptor leads to another file meanwhile."""
    number, python = STREAMS[name], getattr(sys, name)
    python.flush()
    kept = os.dup(number)
    os.dup2(target, number)
    own = open(kept, "w", encoding="utf-8", errors="backslashreplace", buffering=1, closefd=False)  # noqa: SIM115
    if _leads_to(python, number):  # not what a test has put there
        setattr(sys, name, own)
    handlers = _handlers_of(number)
    for handler in handlers:
        handler.setStream(own)
    try:
        yield
    finally:
        for handler, stream in handlers.items():
            handler.setStream(stream)
        setattr(sys, name, python)
        try:
            own.flush()
        finally:
            os.dup2(kept, number)
            os.close(kept)


def _handlers_of(number: int) -> dict[logging.StreamHandler[TextIO], TextIO]:
    """Return the root logger's handlers that write to a descriptor, and their streams."""
    return {
        handler: handler.stream
        for handler in logging.getLogger().handlers
        if isinstance(handler, logging.StreamHandler) and _leads_to(handler.stream, number)
    }


def _leads_to(stream: TextIO, number: int) -> bool:
    try:
        return stream.fileno() == number
    except (AttributeError, OSError, ValueError):
        return False
