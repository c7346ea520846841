"""Keeps what C libraries write to standard error out of what a command says there."""

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

from oaisys_core.system.last_words import say_if_ended
from oaisys_core.system.leftovers import remove_when_killed

STDERR = 2
"""Number of the file descriptor."""


@contextmanager
def keep_messages(prefix: str, sentence: str) -> Iterator[None]:
    """Keep what libraries write to standard error in a temporary file.

    The file is removed at the end, but for one case: a library ends this process within the block.
    Then the process that waits for this one says so, see `say_if_ended`.

    Args:
        prefix: How the name of the file begins.
        sentence: What is said; ``{log}`` in it becomes the path of the file.
    """
    log = Path(tempfile.gettempdir(), f"{prefix}{secrets.token_hex(4)}.log")
    said = sentence.format(log=log)
    with remove_when_killed(log), own_stderr(log), say_if_ended(said, log):
        try:
            yield
        finally:
            log.unlink(missing_ok=True)


@contextmanager
def own_stderr(log: Path) -> Iterator[None]:
    """Reserve standard error for Python; what libraries write there goes to a file.

    Programs that are started within the block write to the file, too.

    Args:
        log: The file; what is written is appended.

    Raises:
        OSError: It cannot be opened.
    """
    sys.stderr.flush()
    target = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o600)
    kept, python = os.dup(2), sys.stderr
    os.dup2(target, 2)
    os.close(target)
    own = open(kept, "w", encoding="utf-8", errors="backslashreplace", buffering=1, closefd=False)  # noqa: SIM115
    if _is_stderr(python):  # not what a test has put there
        sys.stderr = own
    handlers = _handlers_of_stderr()
    for handler in handlers:
        handler.setStream(own)
    try:
        yield
    finally:
        for handler, stream in handlers.items():
            handler.setStream(stream)
        sys.stderr = python
        own.flush()
        os.dup2(kept, 2)
        os.close(kept)


def _handlers_of_stderr() -> dict[logging.StreamHandler[TextIO], TextIO]:
    """Return the root logger's handlers that write to standard error, and their streams."""
    return {
        handler: handler.stream
        for handler in logging.getLogger().handlers
        if isinstance(handler, logging.StreamHandler) and _is_stderr(handler.stream)
    }


def _is_stderr(stream: TextIO) -> bool:
    try:
        return stream.fileno() == STDERR
    except (AttributeError, OSError, ValueError):
        return False
