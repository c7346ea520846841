"""How much memory a worker holds, and how much it may hold."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

MEGABYTE = 1_000_000
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_AUTOMATIC_SHARE = 0.6
"""Share of the machine's memory, unless the user sets a limit."""
_KILL_FACTOR = 1.5
_GROWTH_FACTOR = 1.25
_CONTROL_GROUP_FILES = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)
"""Files with a container's limit, of versions 2 and 1."""


@dataclass(frozen=True)
class MemoryLimits:
    """The memory at which a worker is replaced.

    Attributes:
        recycle_bytes: Above it, a new worker takes its place between two frames.
        kill_bytes: Above it, it is killed at once, before the machine runs out of memory.
    """

    recycle_bytes: float
    kill_bytes: float

    @classmethod
    def of(cls, limit_bytes: int | None) -> MemoryLimits:
        """Return the limits for the user's choice; None: by the machine's memory; 0: no limits."""
        if limit_bytes == 0:
            return cls(float("inf"), float("inf"))
        recycle_bytes = limit_bytes or _AUTOMATIC_SHARE * machine_bytes()
        return cls(recycle_bytes, _KILL_FACTOR * recycle_bytes)

    def outgrown(self, resident_bytes: int, needed_bytes: int) -> bool:
        """Return whether a new worker would help one that holds ``resident_bytes``.

        Args:
            needed_bytes: What it held after its first frame. A world that needs more than the
                limit is not built anew with every frame.
        """
        return resident_bytes > max(self.recycle_bytes, _GROWTH_FACTOR * needed_bytes)


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process; 0 where it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE_BYTES
    except (OSError, IndexError):
        return 0


def machine_bytes() -> int:
    """Return the memory of this machine, or of this container where that has less."""
    found = [os.sysconf("SC_PHYS_PAGES") * _PAGE_BYTES]
    for file in _CONTROL_GROUP_FILES:
        try:
            found.append(int(file.read_text()))
        except (OSError, ValueError):  # there is no such file, or "max" is in it
            continue
    return min(found)
