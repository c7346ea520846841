"""Files of this user alone, under names that others can foresee."""

from __future__ import annotations

import os
import stat
from pathlib import Path

PRIVATE_FOLDER, PRIVATE_FILE = 0o700, 0o600
"""Modes of what is made."""


def open_private(path: Path, flags: int) -> int:
    """Open a file that only this user may read, and return its descriptor; a missing one is made.

    Args:
        path: Its last part is not followed where it is a link.
        flags: Of `os.open`, such as ``os.O_WRONLY | os.O_APPEND``.

    Raises:
        PermissionError: It is another user's, or no regular file.
        OSError: It is a link, or cannot be opened.
    """
    return _open_own(path, flags | os.O_CREAT)


def hide_file(path: Path) -> None:
    """Let this user alone read a file that there is.

    Raises:
        PermissionError: It is another user's, or no regular file.
        OSError: It is a link, or there is none.
    """
    os.close(_open_own(path, os.O_RDONLY))


def _open_own(path: Path, flags: int) -> int:
    flags |= os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(path, flags, PRIVATE_FILE)
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid():
            raise PermissionError(f"{path} is not a regular file of this user")
        os.fchmod(descriptor, PRIVATE_FILE)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
