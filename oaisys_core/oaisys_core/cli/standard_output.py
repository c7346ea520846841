"""Standard output without what libraries print there."""

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
    """Keep standard output for what Python writes: Blender 4.5 prints a line for each tile there.

    Libraries' own output goes to standard error where details are logged, else nowhere.
    """
    sys.stdout.flush()
    shows_all = logging.getLogger().isEnabledFor(logging.DEBUG)
    aside = os.dup(2) if shows_all else os.open(os.devnull, os.O_WRONLY)
    kept, python = os.dup(1), sys.stdout
    os.dup2(aside, 1)
    os.close(aside)
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
    """Drop what C code prints with ``printf``; what Python prints, in any thread, stays.

    Blender 4.5 prints a line for each step of a render, and has no switch for it. The C library's
    stream is replaced, not file descriptor 1, which belongs to the program. Where details are
    logged the lines go to standard error.
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
    """Return the C library's two variables and a stream to nowhere; None where it has others."""
    library = ctypes.CDLL(None)
    try:
        output = ctypes.c_void_p.in_dll(library, "stdout")
        errors = ctypes.c_void_p.in_dll(library, "stderr")
    except ValueError:
        return None
    library.fopen.restype = ctypes.c_void_p
    nowhere = library.fopen(os.devnull.encode(), b"w")
    return None if nowhere is None else (output, errors, int(nowhere))
