"""A folder that keeps texture sets from run to run: bounded, and shared by any number of processes.

An entry is written beside its place and renamed, so that nobody sees half of it. One that is
damaged, or not what its key promises, counts as absent.
"""

from __future__ import annotations

import logging
import os
import tempfile
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np

from oaisys_core.scene import PbrMaps

LOG = logging.getLogger(__name__)

LIMIT_VARIABLE = "OAISYS_CACHE_MB"
"""Environment variable: most megabytes that the folder may hold; 0: there is no cache."""

LIMIT_MB = 1024.0
"""What it holds where the variable is not set: about ninety sets of 1024 pixels."""

SUFFIX, PARTIAL = ".npz", ".tmp"

ABANDONED_S = 3600.0
"""Age from which a partial file is one that its writer left behind."""

KINDS = {
    "color_srgb": (np.uint8, (3,)),
    "height": (np.float32, ()),
    "normal_gl": (np.uint8, (3,)),
    "roughness": (np.uint8, ()),
}
"""Type of each map, and its channels."""

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
"""What NumPy and zipfile raise at files that are no such archive, or are damaged."""


def limit_mb() -> float:
    """Return the most megabytes that the cache may hold; what is no number counts as not set."""
    value = os.environ.get(LIMIT_VARIABLE, "")
    try:
        return max(float(value), 0.0)
    except ValueError:
        if value:
            LOG.warning(
                "%s: received %r, expected a number of megabytes; it is %g MB",
                LIMIT_VARIABLE,
                value,
                LIMIT_MB,
            )
        return LIMIT_MB


def default_cache_dir() -> Path | None:
    """Return the user's cache folder (XDG_CACHE_HOME, or ~/.cache).

    None where it cannot be written to, or the user wants none.
    """
    if limit_mb() == 0:
        return None
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (Path(base) if base else Path.home() / ".cache") / "oaisys" / "textures"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return folder if os.access(folder, os.W_OK) else None


def read(path: Path, name: str, size_px: int) -> PbrMaps | None:
    """Return the texture set in a file, None where there is none that is whole."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            maps = {kind: archive[kind] for kind in KINDS}
            tile_m = float(archive["tile_m"])
        for kind, (dtype, channels) in KINDS.items():
            if maps[kind].dtype != dtype or maps[kind].shape != (size_px, size_px, *channels):
                raise ValueError(f"{kind} is {maps[kind].dtype} of {maps[kind].shape}")
    except FileNotFoundError:
        return None
    except UNREADABLE as error:
        LOG.warning("the cached texture %s is not readable and is made again: %s", path, error)
        return None
    _touch(path)
    return PbrMaps(name=name, tile_m=tile_m, **maps)


def write(path: Path, maps: PbrMaps) -> None:
    """Keep a texture set; what was not used for longest goes where there is no room for all."""
    partial: Path | None = None
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=PARTIAL, delete=False) as file:
            partial = Path(file.name)
            arrays = {kind: getattr(maps, kind) for kind in KINDS}
            np.savez(file, tile_m=np.array(maps.tile_m), **arrays)
        partial.replace(path)
        trim(path.parent, limit_mb() * 1e6)
    except OSError as error:
        LOG.warning("the texture cache %s cannot be written: %s", path, error)
        if partial is not None:
            partial.unlink(missing_ok=True)


def trim(folder: Path, most_bytes: float) -> None:
    """Remove the entries unused for longest until the rest fits, and what broken writers left."""
    now_s = time.time()
    entries = []
    for path in folder.iterdir():
        try:
            status = path.stat()
        except OSError:
            # Another process was faster.
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


def _touch(path: Path) -> None:
    """Say that an entry was used now."""
    try:
        os.utime(path)
    except OSError as error:
        LOG.debug("the cached texture %s cannot be marked as used: %s", path, error)
