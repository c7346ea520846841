"""Errors that mean that this process may not have more memory, threads or files."""

from __future__ import annotations

import errno

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
    "annot allocate memory": _BY_NUMBER[errno.ENOMEM],
    "Too many open files": _BY_NUMBER[errno.EMFILE],
}


def shortage(error: BaseException) -> ShortageError | None:
    """Return an error that says what this process lacks; None if that is not why it failed."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return ShortageError(_BY_NUMBER[errno.ENOMEM])
        if isinstance(cause, OSError) and cause.errno in _BY_NUMBER:
            where = f" ({cause.filename})" if cause.filename else ""
            return ShortageError(_BY_NUMBER[cause.errno] + where)
        if isinstance(cause, ImportError | RuntimeError):
            for sign, text in _BY_TEXT.items():
                if sign in str(cause):
                    return ShortageError(text)
        cause = cause.__cause__ or cause.__context__
    return None
