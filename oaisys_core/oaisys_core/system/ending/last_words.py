"""What is to be said if the process that works ends without a word; the one that waits says it.

Libraries such as Ray end a process on threads of their own, with no exception and no handler. The
words are in memory without a name, which both processes share.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MAX_BYTES = 16384


class LastWords:
    """The words of one command."""

    def __init__(self) -> None:
        self._file = os.memfd_create("oaisys-last-words", os.MFD_CLOEXEC)

    def set(self, text: str, kept: Path | None = None) -> None:
        """Set the words, and a file that they name and that is kept then; no text: no words."""
        # Names of files may have any byte but 0.
        data = os.fsencode(f"{kept or ''}\0{text}")[:MAX_BYTES] if text else b""
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, data, 0)

    def read(self) -> tuple[str, Path | None]:
        """Return the words, and the file to keep; inverse: `set`."""
        kept, _, text = os.pread(self._file, MAX_BYTES, 0).partition(b"\0")
        return os.fsdecode(text), Path(os.fsdecode(kept)) if kept else None


_record: LastWords | None = None


def record_last_words(words: LastWords) -> None:
    """Have this process leave its words there."""
    global _record
    _record = words


@contextmanager
def say_if_ended(text: str, kept: Path | None = None) -> Iterator[None]:
    """Have the waiting process say something if this one ends within the block.

    An exception ends the block, too: whoever handles it says what went wrong.

    Args:
        text: What is said.
        kept: A temporary file that the text names; it is not removed then.
    """
    if _record is None:
        yield
        return
    _record.set(text, kept)
    try:
        yield
    finally:
        _record.set("")
