"""Writing files atomically: a file is complete or unchanged, even if the disk is full."""

from __future__ import annotations

import csv
import io
import os
import stat
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from oaisys_core.errors import RenderError
from oaisys_core.system.leftovers import remove_when_killed


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield the path of an empty temporary file that replaces ``path`` if the block succeeds.

    Raises:
        RenderError: It could not be written, or ``path`` is a device, a pipe or a folder, which a
            file must not replace; ``path`` is unchanged.
    """
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    with remove_when_killed(part):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _require_file(path)
            _make_anew(part)
            yield part
            part.replace(path)
        except OSError as error:
            raise RenderError(f"{path}: could not be written: {error.strerror or error}") from error
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)


def _require_file(path: Path) -> None:
    """Raise `OSError` where a file must not replace what is at ``path``, such as /dev/null."""
    with suppress(FileNotFoundError):
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise OSError("it exists, and is no regular file")
        if path.is_symlink() and path.parent.resolve() == Path("/dev"):  # such as /dev/stdout
            raise OSError("it is a name of the system")


def _make_anew(part: Path) -> None:
    """Make an empty file; a link that somebody else put there is removed, not followed."""
    part.unlink(missing_ok=True)
    flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC
    os.close(os.open(part, flags, 0o666))


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
