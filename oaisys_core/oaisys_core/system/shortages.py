"""Errors that mean that this process lacks memory, threads, files or a current folder."""

from __future__ import annotations

import errno
import resource
from pathlib import Path

from oaisys_core.errors import ShortageError

_BY_NUMBER = {
    errno.ENOMEM: "there is no memory left for this process (ulimit -v, or the container's limit)",
    errno.EMFILE: "this process may open no more files (ulimit -n)",
    errno.ENFILE: "this machine may open no more files",
    errno.ENOSPC: "there is no space left on the disk, or in /dev/shm",
    errno.EFBIG: "a file may not be that large for this process (ulimit -f)",
}

_BY_TEXT = {
    "can't start new thread": "this process may start no more threads (ulimit -u or -v)",
    "failed to map segment": _BY_NUMBER[errno.ENOMEM],
    "cannot allocate memory": _BY_NUMBER[errno.ENOMEM],
    "out of memory": _BY_NUMBER[errno.ENOMEM],
    "malloc failed": _BY_NUMBER[errno.ENOMEM],
    "bad_alloc": _BY_NUMBER[errno.ENOMEM],
    "too many open files": _BY_NUMBER[errno.EMFILE],
}
"""By what libraries write, such as the linker, Embree and Open3D, in lower case."""

MIN_ADDRESS_SPACE = 700_000_000
"""Bytes; with less, OpenBLAS may try to get memory for ever while it is imported."""


def shortage(error: BaseException) -> ShortageError | None:
    """Return an error that says what this process lacks; None if that is not why it failed."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return ShortageError(_BY_NUMBER[errno.ENOMEM])
        if isinstance(cause, OSError) and cause.errno in _BY_NUMBER:
            where = f" ({cause.filename})" if cause.filename else ""
            return ShortageError(_BY_NUMBER[cause.errno] + where)
        if isinstance(cause, ImportError | RuntimeError | OSError):
            said = str(cause).lower()
            for sign, text in _BY_TEXT.items():
                if sign in said:
                    return ShortageError(text)
        cause = cause.__cause__ or cause.__context__
    return None


def check_address_space() -> None:
    """Raise if this process may have too little memory to import what it needs.

    Raises:
        ShortageError: ``ulimit -v`` is below `MIN_ADDRESS_SPACE`.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < MIN_ADDRESS_SPACE:
        raise ShortageError(
            f"this process may have {limit} bytes of address space, and it needs"
            f" {MIN_ADDRESS_SPACE}: ulimit -v"
        )


def check_current_folder() -> None:
    """Raise if the current folder has been removed.

    Open3D's libraries look for each other from there. Without it some exit, and others then wait
    for ever.

    Raises:
        ShortageError: It has been removed.
    """
    try:
        Path.cwd()
    except OSError as error:
        text = "the current folder has been removed: change to one that exists"
        raise ShortageError(text) from error
