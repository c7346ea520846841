"""Files and folders, complete under their name or unchanged whenever the program is killed."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.folders import make_folder
from oaisys_core.files.temporary_files import temporary_file
from oaisys_core.system.ending.leftovers import remove_when_killed


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield the path of an empty temporary file that replaces ``path`` if the block succeeds.

    Of writers at the same time, each has a file of its own, and the last to end wins. See
    `temporary_file`.

    Raises:
        InvalidInputError: The path has no name, as that of an empty text.
        OSError: It could not be made or renamed, or ``path`` is a device, a pipe or a folder, which
            a file must not replace; ``path`` is unchanged.
    """
    _require_name(path, "path", "a file")
    _require_file(path)
    with temporary_file(path) as part:
        try:
            yield part
            part.replace(path)
        except OSError as error:
            if error.filename != str(part):
                raise
            # The temporary name would tell nobody anything.
            raise OSError(error.errno, error.strerror, str(path)) from error


def write_whole_text(path: Path, text: str) -> None:
    """Write UTF-8 text to a file, see `whole_file`."""
    write_whole_bytes(path, text.encode())


def write_whole_bytes(path: Path, data: bytes) -> None:
    """Write bytes to a file, see `whole_file`."""
    with whole_file(path) as part:
        part.write_bytes(data)


def check_output_file(path: Path, field: str = "out") -> Path:
    """Return the path of a file that is written after long work; its folder is made.

    Args:
        path: The file.
        field: What the user calls it, in errors.

    Raises:
        InvalidInputError: No file can be written under this name.
        OSError: The disk is full, or fails.
    """
    _require_name(path, field, "a file")
    make_folder(path.parent, field)
    try:
        _require_file(path)
    except OSError as error:
        expected = f"a file that can be written ({error.strerror})"
        raise InvalidInputError(field, str(path), expected) from error
    if not os.access(path.parent, os.W_OK):
        raise InvalidInputError(field, str(path), "a file in a folder that can be written to")
    return path


def _require_name(path: Path, field: str, what: str) -> None:
    if not path.name:
        raise InvalidInputError(field, str(path), f"the name of {what}")


def _require_file(path: Path) -> None:
    """Raise `OSError` where a file must not replace what is at ``path``, such as /dev/null."""
    with suppress(FileNotFoundError):
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "it exists, and is no regular file", str(path))
        if path.is_symlink() and path.parent.resolve() == Path("/dev"):  # such as /dev/stdout
            raise OSError(errno.EINVAL, "it is a name of the system", str(path))


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """Yield an empty folder that becomes ``target`` if the block succeeds.

    Args:
        target: A path where there is nothing, or an empty folder.

    Raises:
        InvalidInputError: The path has no name, as that of an empty text.
        OSError: It could not be made or renamed; nothing is left.
    """
    _require_name(target, "path", "a folder")
    # A name that nobody can foresee: the folder may be in a data set of somebody else.
    part = target.with_name(f".{target.name}.{uuid.uuid4().hex}.part")
    make_folder(target.parent)
    with remove_when_killed(part):
        try:
            make_folder(part)
            yield part
            part.replace(target)
        finally:
            shutil.rmtree(part, ignore_errors=True)
