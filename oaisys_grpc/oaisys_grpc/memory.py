"""Settings of the C library's heap for programs that receive many images."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

from oaisys_core.system.freed_memory import return_freed_memory

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
"""Of glibc's ``mallopt``, from ``malloc.h``."""

KEPT_BYTES = 128 * 2**20
"""Freed memory at the end of a heap that is kept: some ten samples of 640x480 pixels."""
FROM_HEAP_BYTES = 32 * 2**20
"""The largest value that glibc allows; larger blocks are mapped and unmapped each time."""
HEAPS = 2
"""Heaps that all threads share, so that not each thread keeps freed memory."""

GROWN_BYTES = 16 * 2**20
"""Growth since the last time after which freed memory is returned to the system."""
SHRUNK_BYTES = 2**20
"""What goes by itself since the last time is a sign that there is more: a middleware lets go of a
large message seconds after its call has ended."""

PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def keep_freed_memory() -> None:
    """Keep freed memory for later allocations instead of returning it to the system.

    By default, glibc returns the buffers of a sample, several megabytes, and gets new, zeroed pages
    for the next one: a third of the time that sending or publishing a sample takes. It applies to
    the whole process, so call it in programs, not in libraries, before threads are started. It does
    nothing with another C library than glibc.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return
    mallopt(M_MMAP_THRESHOLD, FROM_HEAP_BYTES)
    mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
    mallopt(M_ARENA_MAX, HEAPS)


class IdleMemory:
    """Returns the memory that `keep_freed_memory` keeps to the system when the process is idle."""

    def __init__(self) -> None:
        self._held_bytes = resident_bytes(os.getpid())

    def give_back(self) -> None:
        """Return freed memory if this process has grown or shrunk since the last time."""
        change = resident_bytes(os.getpid()) - self._held_bytes
        if change > GROWN_BYTES or change < -SHRUNK_BYTES:
            return_freed_memory()
            self._held_bytes = resident_bytes(os.getpid())


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process; 0 where it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE_BYTES
    except (OSError, IndexError):
        return 0
