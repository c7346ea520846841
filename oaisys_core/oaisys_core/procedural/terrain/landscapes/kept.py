"""Grounds that processes made, kept on disk by a hash of all that they depend on."""

from __future__ import annotations

import hashlib
import logging
import secrets
from collections.abc import Callable, Hashable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.stage import MAX_PX
from oaisys_core.files.arrays import load_arrays
from oaisys_core.procedural.textures import cache
from oaisys_core.procedural.textures.code_version import version_of
from oaisys_core.system.ending.leftovers import remove_when_killed
from oaisys_core.types import FloatArray

LOG = logging.getLogger(__name__)

FOLDER = "grounds"
"""Folder in the user's cache."""

CODE = (
    "procedural/terrain/landscapes",
    "procedural/terrain/processes",
    "procedural/terrain/erosion.py",
    "procedural/terrain/landform.py",
    "procedural/terrain/mountains.py",
    "procedural/terrain/noise.py",
    "procedural/terrain/sculpted.py",
    "randomness.py",
)
"""Files and folders of the package with the code that makes them."""

MAX_GROUND_BYTES = MAX_PX * MAX_PX * 4 + 4096


def make_once(
    name: str, key: Hashable, rng: np.random.Generator, make: Callable[[], FloatArray]
) -> NDArray[np.float32]:
    """Return heights that were made before, or make and keep them.

    Args:
        name: What begins the file's name.
        key: What they depend on beside ``rng`` and the code, with a unique representation.
        rng: Draws them; nothing may be drawn from it afterwards, because it may be unused.
        make: Makes them.
    """
    path = _path(name, key, rng)
    found = None if path is None else _read(path)
    if found is not None:
        return found
    made = np.asarray(make(), np.float32)
    if path is not None:
        _write(path, made)
    return made


def _path(name: str, key: Hashable, rng: np.random.Generator) -> Path | None:
    folder = cache.default_cache_dir(FOLDER)
    if folder is None:
        return None
    state = rng.bit_generator.state
    text = repr((version_of(CODE), name, key, state))
    return folder / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:24]}{cache.SUFFIX}"


def _read(path: Path) -> NDArray[np.float32] | None:
    try:
        heights = load_arrays(path, MAX_GROUND_BYTES)["elevation_m"]
        if heights.dtype != np.float32 or heights.ndim != 2 or not np.isfinite(heights).all():
            raise ValueError(f"received {heights.dtype} of {heights.shape}, expected heights")
    except FileNotFoundError:
        return None
    except cache.UNREADABLE as error:
        LOG.warning("the kept ground %s is not readable and will be made again: %s", path, error)
        return None
    cache.touch(path)
    return np.asarray(heights)


def _write(path: Path, heights: NDArray[np.float32]) -> None:
    partial = path.with_name(f"{secrets.token_hex(8)}{cache.PARTIAL}")
    try:
        with remove_when_killed(partial):
            with partial.open("xb") as file:
                np.savez(file, elevation_m=heights)
            partial.replace(path)
        cache.trim(path.parent, cache.limit_mb() * 1e6 / 4)
    except OSError as error:
        LOG.warning("the ground %s cannot be kept: %s", path, error)
        partial.unlink(missing_ok=True)
