"""Folders that a user names: those for output, and home folders.

A shell expands ``~`` neither in ``--out=~/x`` nor in a service's request or a parameter: a folder
of that name was made.
"""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from oaisys_core.errors import InvalidInputError, NotReadyError

SHORTAGES = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.EIO})
"""Errors that are no fault of the name."""

LONGEST_PATH, LONGEST_FILE_NAME = 4095, 255
"""Bytes of a path, and of each name in it, that Linux takes."""


def make_folder(folder: Path, field: str = "out") -> Path:
    """Make a folder for output, and those above it, if it is missing; return it.

    Args:
        folder: The folder.
        field: What the user calls it, in errors.

    Raises:
        InvalidInputError: There can be none of this name.
        OSError: The disk is full, or fails.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if error.errno in SHORTAGES:
            raise
        expected = f"a folder that can be made ({error.strerror})"
        raise InvalidInputError(field, str(folder), expected) from error
    return folder


@contextmanager
def own_folder(folder: Path, field: str = "out") -> Iterator[Path]:
    """Make a folder for output, and keep other commands out of it during a block; yield it.

    The lock is one of the folder itself, leaves no file, and ends with its process. If the block
    fails before anything was written, the folders that were made for it are removed.

    Args:
        folder: The folder.
        field: What the user calls it, in errors.

    Raises:
        NotReadyError: Another command is writing to it.
        InvalidInputError, OSError: See `make_folder`.
    """
    made = _missing(folder)
    descriptor = os.open(make_folder(folder, field), os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise NotReadyError(f"{folder}: another command is writing to it") from None
        try:
            yield folder
        except BaseException:
            with suppress(OSError):  # the first one that is not empty
                for each in made:
                    each.rmdir()
            raise
    finally:
        os.close(descriptor)


def _missing(folder: Path) -> list[Path]:
    """Return which of a folder and those above it are not there, the innermost first."""
    found = []
    with suppress(OSError):  # no file can have the name
        for each in (folder, *folder.parents):
            if each.exists():
                break
            found.append(each)
    return found


def user_path(text: str | Path, field: str) -> Path:
    """Return a path in which ``~`` or ``~NAME`` at the begin is the home folder of a user.

    Files that are called so are named with their folder's absolute path.

    Args:
        text: The path.
        field: What the user calls it, in errors.

    Raises:
        InvalidInputError: The text is empty, which is no name of the current folder, or no file can
            have the name. There is no such user, or nobody knows where this one's home is.
    """
    if text == "":
        raise InvalidInputError(field, text, "a path, no empty text")
    _check_length(str(text), field)
    path = Path(text)
    try:
        return path.expanduser()
    except RuntimeError:
        name = path.parts[0][1:]
        expected = f"~NAME of a user of this machine, not {name!r}" if name else "no ~ without HOME"
        raise InvalidInputError(field, str(path), expected) from None


def _check_length(text: str, field: str) -> None:
    """Raise `InvalidInputError` for a path that Linux takes for no file's."""
    data = text.encode(errors="surrogatepass")
    if len(data) > LONGEST_PATH or max(map(len, data.split(b"/"))) > LONGEST_FILE_NAME:
        expected = f"at most {LONGEST_PATH} bytes, and {LONGEST_FILE_NAME} for each name in it"
        raise InvalidInputError(field, text, expected)
    if "\0" in text:
        raise InvalidInputError(field, text, "a path without the character 0")


def user_file(text: str, field: str, suffixes: tuple[str, ...]) -> Path:
    """Return the path of a file to write, as `user_path`; its suffix says what is written.

    Args:
        text: The path.
        field: What the user calls it, in errors.
        suffixes: Those of the formats that can be written, in lower case.

    Raises:
        InvalidInputError: The path has none of them, in any case, or `user_path` raises it.
    """
    path = user_path(text, field)
    if path.suffix.lower() not in suffixes:
        expected = f"a file whose name ends with {' or '.join(suffixes)}"
        raise InvalidInputError(field, text, expected)
    return path
