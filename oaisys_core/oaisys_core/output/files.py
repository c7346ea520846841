"""Writing files atomically: a file is complete or unchanged, even if the disk is full."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from oaisys_core.errors import RenderError
from oaisys_core.files.whole_files import whole_file


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield the path of an empty temporary file that replaces ``path`` if the block succeeds.

    Raises:
        RenderError: It could not be written, or ``path`` is a device, a pipe or a folder, which a
            file must not replace; ``path`` is unchanged.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as part:
            yield part
    except OSError as error:
        raise RenderError(f"{path}: could not be written: {error.strerror or error}") from error


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes to a file atomically."""
    with whole(path) as part:
        part.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text to a file atomically."""
    write_bytes(path, text.encode())


def csv_text(rows: Iterable[Sequence[object]], line_end: str = "\n") -> str:
    """Return the text of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator=line_end).writerows(rows)
    return text.getvalue()


def append_text(path: Path, text: str) -> None:
    """Append text to a file, or leave the file unchanged.

    Raises:
        RenderError: It could not be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        size = path.stat().st_size if path.exists() else 0
        try:
            with path.open("ab") as file:
                file.write(text.encode())
        except OSError:
            os.truncate(path, size)
            raise
    except OSError as error:
        raise RenderError(f"{path}: could not be written: {error.strerror or error}") from error
