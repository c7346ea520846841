"""What the C library does with memory that is given back to it."""

from __future__ import annotations

import ctypes
import os

from oaisys_grpc.server.supervision.worker_memory import resident_bytes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
"""Of glibc's ``mallopt``, from ``malloc.h``."""

KEPT_BYTES = 128 * 2**20
"""Freed memory at the end of a heap that is not returned: some ten samples of 640x480 pixels."""
FROM_HEAP_BYTES = 32 * 2**20
"""The largest that glibc allows; what is larger is mapped and unmapped each time."""
HEAPS = 2
"""Threads share them, so that each does not keep memory of its own."""

GROWN_BYTES = 16 * 2**20
"""So much more than after the last time, and freed memory is returned to the system."""


def keep_freed_memory() -> None:
    """Use memory again instead of returning it to the system and asking for it anew.

    A sample passes through several buffers of megabytes. By default each of their pages is taken
    away and given back, zeroed, at every sample: a third of the time that sending or publishing it
    costs. For programs, not libraries, as it holds for the whole process. Call it before there are
    threads. Does nothing where the C library is another than glibc.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return
    mallopt(M_MMAP_THRESHOLD, FROM_HEAP_BYTES)
    mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
    mallopt(M_ARENA_MAX, HEAPS)


class IdleMemory:
    """Returns to the system, when nobody waits, what `keep_freed_memory` keeps."""

    def __init__(self) -> None:
        self._least_bytes = resident_bytes(os.getpid())
        self._trim = getattr(ctypes.CDLL(None), "malloc_trim", None)

    def give_back(self) -> None:
        """Return freed memory, if this process has grown since it last did so."""
        held = resident_bytes(os.getpid())
        if self._trim is not None and held > self._least_bytes + GROWN_BYTES:
            self._trim(0)
            self._least_bytes = resident_bytes(os.getpid())
        self._least_bytes = min(self._least_bytes, held)
