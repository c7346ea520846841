"""Unix sockets: which paths fit, and where there is a folder for them.

The kernel takes paths of at most 107 bytes, and what makes a socket often says so only after it has
made other things.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from oaisys_core.errors import InvalidInputError

MAX_PATH_BYTES = 107
"""Longest path of a Unix socket in Linux, which keeps 108 with a 0 at the end."""


def socket_parent(below_bytes: int) -> Path:
    """Return a folder for temporary files in which the paths of sockets fit, and are UTF-8.

    It is the usual one (``TMPDIR``), or else that of the user's session, or /tmp.

    Args:
        below_bytes: Length of the longest path in the folder, its first slash included.

    Raises:
        InvalidInputError: There is no such folder.
    """
    usual = tempfile.gettempdir()
    for parent in (usual, os.environ.get("XDG_RUNTIME_DIR", ""), "/tmp"):  # noqa: S108
        if parent and fits(parent, below_bytes) and _is_utf8(parent) and _is_usable(parent):
            return Path(parent)
    most = MAX_PATH_BYTES - below_bytes
    expected = f"a folder of at most {most} bytes, in UTF-8, for sockets in it"
    raise InvalidInputError("TMPDIR", usual, expected)


def fits(folder: str | Path, below_bytes: int = 0) -> bool:
    """Return whether a path is short enough for a socket, ``below_bytes`` below it."""
    return len(os.fsencode(folder)) + below_bytes <= MAX_PATH_BYTES


def _is_utf8(folder: str) -> bool:
    """Return whether Ray and gRPC can be told a path: they take texts in UTF-8."""
    try:
        folder.encode()
    except UnicodeEncodeError:
        return False
    return True


def _is_usable(folder: str) -> bool:
    return Path(folder).is_absolute() and os.access(folder, os.W_OK | os.X_OK)
