"""Keeps the output of C libraries out of standard output."""

from __future__ import annotations

import ctypes
import functools
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def own_stdout() -> Iterator[None]:
    """Reserve standard output for Python; Blender 4.5, for example, prints a line for each tile.

    Output of libraries goes to standard error if debug logging is on, otherwise it is dropped.
    """
    sys.stdout.flush()
    shows_all = logging.getLogger().isEnabledFor(logging.DEBUG)
    target = os.dup(2) if shows_all else os.open(os.devnull, os.O_WRONLY)
    kept, python = os.dup(1), sys.stdout
    os.dup2(target, 1)
    os.close(target)
    sys.stdout = open(kept, "w", encoding="utf-8", buffering=1, closefd=False)  # noqa: SIM115
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stdout = python
        os.dup2(kept, 1)
        os.close(kept)


@contextmanager
def without_c_output() -> Iterator[None]:
    """Drop the output of C code, but not that of Python in any thread.

    Blender 4.5 prints a line for each step of a render and has no option against it. This replaces
    the stream of the C library and not file descriptor 1, which belongs to the program. If debug
    logging is on, the output goes to standard error.
    """
    streams = _c_streams()
    if streams is None:
        yield
        return
    output, errors, nowhere = streams
    kept = output.value
    output.value = errors.value if logging.getLogger().isEnabledFor(logging.DEBUG) else nowhere
    try:
        yield
    finally:
        output.value = kept


@functools.cache
def _c_streams() -> tuple[ctypes.c_void_p, ctypes.c_void_p, int] | None:
    """Return the C library's stdout and stderr, and a null stream; None if it has other names."""
    library = ctypes.CDLL(None)
    try:
        output = ctypes.c_void_p.in_dll(library, "stdout")
        errors = ctypes.c_void_p.in_dll(library, "stderr")
    except ValueError:
        return None
    library.fopen.restype = ctypes.c_void_p
    nowhere = library.fopen(os.devnull.encode(), b"w")
    return None if nowhere is None else (output, errors, int(nowhere))
