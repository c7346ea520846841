"""A cache of built ROS interfaces in the user's cache folder, for any number of processes.

Entries are written atomically. A damaged entry is not used.
"""

from __future__ import annotations

import contextlib
import gzip
import os
import stat
import tempfile
import zlib
from pathlib import Path

MAX_ENTRIES = 8
"""The least recently used ones beyond this number are removed; each has some megabytes."""

_SUFFIX = ".tar.gz"


def cache_folder() -> Path | None:
    """Return the folder of the entries; None if it cannot be made or the cache is disabled.

    None, too, if others may write to it: what is in an entry is executed.
    """
    if os.environ.get("OAISYS_CACHE_MB") == "0":
        return None
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (Path(base) if base else Path.home() / ".cache") / "oaisys" / "interfaces"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except (OSError, RuntimeError):
        return None
    own = found.st_uid == os.geteuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return folder if own else None


def read_entry(folder: Path, key: str) -> bytes | None:
    """Return what was written with ``key``, or None if there is nothing or it is damaged."""
    entry = folder / f"{key}{_SUFFIX}"
    try:
        content = gzip.decompress(entry.read_bytes())  # checks length and checksum
    except (OSError, EOFError, zlib.error):
        return None
    if not content:
        return None  # an empty file has no checksum
    with contextlib.suppress(OSError):
        os.utime(entry)
    return content


def write_entry(folder: Path, key: str, content: bytes) -> None:
    """Write an entry, if the folder is writable, and remove the least recently used ones."""
    with contextlib.suppress(OSError):
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".tmp", delete=False) as file:
            partial = Path(file.name)
            try:
                file.write(gzip.compress(content, compresslevel=1))
                file.flush()
                partial.replace(folder / f"{key}{_SUFFIX}")
            except OSError:
                partial.unlink(missing_ok=True)
                return
        by_age = sorted(folder.glob(f"*{_SUFFIX}"), key=lambda path: path.stat().st_mtime_ns)
        for entry in by_age[:-MAX_ENTRIES]:
            entry.unlink(missing_ok=True)
