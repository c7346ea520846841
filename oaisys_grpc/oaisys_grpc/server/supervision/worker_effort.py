"""What a process computes, measured by the kernel: on a busy machine, time alone says nothing."""

from __future__ import annotations

import os
import time
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_USER, _SYSTEM = 11, 12
"""Fields of a thread's ``stat`` behind the name in brackets."""


class Effort:
    """What a process computes from now on."""

    def __init__(self, pid: int) -> None:
        self._threads = Path(f"/proc/{pid}/task")
        self._begin = self._last = self._ticks()
        self._moved_s = time.monotonic()

    def look(self) -> tuple[float, float]:
        """Return the processor's seconds of its busiest thread, and for how long none had any.

        Look often: what happens between two looks is taken to happen at the second one.
        """
        ticks = self._ticks()
        now_s = time.monotonic()
        if ticks != self._last:
            self._last, self._moved_s = ticks, now_s
        used = (count - self._begin.get(thread, 0) for thread, count in ticks.items())
        return max(used, default=0) / _TICKS_PER_S, now_s - self._moved_s

    def _ticks(self) -> dict[str, int]:
        ticks = {}
        for file in self._threads.glob("*/stat"):
            try:
                fields = file.read_text().rpartition(")")[2].split()
            except OSError:  # it has ended meanwhile
                continue
            ticks[file.parent.name] = int(fields[_USER]) + int(fields[_SYSTEM])
        return ticks
