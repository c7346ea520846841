"""Whether a file is still the one that was read."""

from __future__ import annotations

from pathlib import Path

Version = tuple[Path, int, int]


def version_of(path: Path) -> Version:
    """Return a file's path without links, its time of change in nanoseconds, and its bytes.

    Raises:
        OSError: It is gone, or may not be looked at.
    """
    status = path.stat()
    return path.resolve(), status.st_mtime_ns, status.st_size
