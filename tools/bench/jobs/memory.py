"""Peak memory of a process."""

from __future__ import annotations

from pathlib import Path

MEGABYTE = 1e6


def peak_memory_mb(process: str = "self") -> float:
    """Return the largest resident memory that a process has had so far."""
    for line in Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / MEGABYTE
    raise ValueError(f"/proc/{process}/status says nothing of VmHWM")
