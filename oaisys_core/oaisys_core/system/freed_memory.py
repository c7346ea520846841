"""Memory that the C library keeps after it was freed."""

from __future__ import annotations

import ctypes


def return_freed_memory() -> None:
    """Return memory to the system that the old world or its making has freed.

    glibc keeps it otherwise, some 0.4 GB after the demo's second batch. With another C library
    nothing is done.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
