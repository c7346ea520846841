"""The stream ``stdout`` of the C library, to which Blender prints.

Blender 4.5 prints a line for each step of a render and has no option against it.

Private part: the variable ``stdout`` of the C library, which is set to another stream. It is not
    file descriptor 1, which belongs to the program.
Tried with: glibc 2.36.
Public way without it: Blender's lines are printed.
Lost without it: a quiet standard output; ``oaisys render`` prints thousands of lines.
"""

from __future__ import annotations

import ctypes
import functools
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager

from oaisys_core.system.fallbacks import report_fallback

OUTPUT, ERRORS = "stdout", "stderr"
"""The C library's names of its streams."""


@contextmanager
def without_c_output() -> Iterator[None]:
    """Drop the output of C code, but not that of Python in any thread.

    If debug logging is on, the output goes to standard error.
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
        output = ctypes.c_void_p.in_dll(library, OUTPUT)
        errors = ctypes.c_void_p.in_dll(library, ERRORS)
    except ValueError as error:
        report_fallback(
            "The C library's stream of output", str(error), "Blender prints what it does"
        )
        return None
    library.fopen.restype = ctypes.c_void_p
    nowhere = library.fopen(os.devnull.encode(), b"w")
    return None if nowhere is None else (output, errors, int(nowhere))
