"""A cache of texture sets on disk, with a size limit, for any number of processes.

Entries are written atomically. Damaged entries, and entries with unexpected content, are ignored.
"""

from __future__ import annotations

import logging
import os
import secrets
import time
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.files.arrays import load_arrays
from oaisys_core.scene import PbrMaps
from oaisys_core.system.ending.leftovers import remove_when_killed

LOG = logging.getLogger(__name__)

LIMIT_VARIABLE = "OAISYS_CACHE_MB"
"""Environment variable with the size limit in megabytes; 0 disables the cache."""

LIMIT_MB = 1024.0
"""Default size limit: about ninety sets of 1024 pixels, or twenty of 2048."""

SUFFIX, PARTIAL = ".npz", ".tmp"

ABANDONED_S = 3600.0
"""Age from which a partial file is considered abandoned."""

KINDS = {
    "color_srgb": (np.uint8, (3,)),
    "height": (np.float32, ()),
    "normal_gl": (np.uint8, (3,)),
    "roughness": (np.uint8, ()),
}
"""The type and the channels of each map."""

UNREADABLE = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    SyntaxError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Exceptions of NumPy and zipfile for damaged files and files of another kind."""


def limit_mb() -> float:
    """Return the size limit in megabytes; an invalid value of the variable is ignored."""
    value = os.environ.get(LIMIT_VARIABLE, "")
    try:
        return max(float(value), 0.0)
    except ValueError:
        if value:
            LOG.warning(
                "%s: received %r, expected a number of megabytes; using %g MB",
                LIMIT_VARIABLE,
                value,
                LIMIT_MB,
            )
        return LIMIT_MB


def default_cache_dir(kind: str = "textures") -> Path | None:
    """Return a folder in the user's cache (XDG_CACHE_HOME, or ~/.cache).

    None if it is not writable, or the cache is disabled.
    """
    if limit_mb() == 0:
        return None
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (Path(base) if base else Path.home() / ".cache") / "oaisys" / kind
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return folder if os.access(folder, os.W_OK) else None


MAX_SET_BYTES = 2_000_000_000
"""Size of the arrays in a file; a set of 8192 pixels takes 0.9 GB."""


def read(path: Path, name: str, size_px: int) -> PbrMaps | None:
    """Return the texture set in a file, or None if there is no valid one."""
    try:
        archive = load_arrays(path, MAX_SET_BYTES)
        maps: dict[str, Any] = {kind: archive[kind] for kind in KINDS}
        tile_m = float(archive["tile_m"])
        for kind, (dtype, channels) in KINDS.items():
            if maps[kind].dtype != dtype or maps[kind].shape != (size_px, size_px, *channels):
                raise ValueError(f"{kind} is {maps[kind].dtype} of {maps[kind].shape}")
    except FileNotFoundError:
        return None
    except UNREADABLE as error:
        LOG.warning("the cached texture %s is not readable and will be made again: %s", path, error)
        return None
    touch(path)
    return PbrMaps(name=name, tile_m=tile_m, **maps)


def write(path: Path, maps: PbrMaps) -> None:
    """Write a texture set to the cache, and remove the least recently used ones over the limit."""
    partial = path.with_name(f"{secrets.token_hex(8)}{PARTIAL}")
    try:
        with remove_when_killed(partial):
            with partial.open("xb") as file:
                arrays = {kind: getattr(maps, kind) for kind in KINDS}
                np.savez(file, tile_m=np.array(maps.tile_m), **arrays)
            partial.replace(path)
        trim(path.parent, limit_mb() * 1e6)
    except OSError as error:
        LOG.warning("the texture cache %s cannot be written: %s", path, error)
        partial.unlink(missing_ok=True)


def trim(folder: Path, most_bytes: float) -> None:
    """Remove the least recently used entries beyond a size, and abandoned partial files."""
    now_s = time.time()
    entries = []
    for path in folder.iterdir():
        try:
            status = path.stat()
        except OSError:
            # Another process has removed it.
            continue
        if path.suffix == SUFFIX:
            entries.append((status.st_mtime_ns, status.st_size, path))
        elif path.suffix == PARTIAL and now_s - status.st_mtime > ABANDONED_S:
            path.unlink(missing_ok=True)
    held = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if held <= most_bytes:
            return
        path.unlink(missing_ok=True)
        held -= size


def touch(path: Path) -> None:
    """Mark an entry as just used."""
    try:
        os.utime(path)
    except OSError as error:
        LOG.debug("the cached texture %s cannot be marked as used: %s", path, error)
