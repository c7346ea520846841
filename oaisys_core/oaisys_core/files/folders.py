"""Folders that a user names for output."""

from __future__ import annotations

import errno
from pathlib import Path

from oaisys_core.errors import InvalidInputError

SHORTAGES = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.EIO})
"""Errors that are no fault of the name."""


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
