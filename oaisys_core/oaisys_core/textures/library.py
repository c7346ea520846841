"""Built-in texture sets by name, kept in a cache because they take seconds to make."""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from oaisys_core import randomness
from oaisys_core.errors import InvalidInputError
from oaisys_core.scene import PbrMaps
from oaisys_core.textures.fields import normals_from_height
from oaisys_core.textures.procedural import RECIPES

LOG = logging.getLogger(__name__)

TEXTURES = frozenset(RECIPES)


def texture_set(name: str, size_px: int, seed: int, cache_dir: Path | None) -> PbrMaps:
    """Return a built-in texture set, from the cache where it is there.

    Args:
        name: One of `TEXTURES`.
        size_px: Edge length of its maps.
        seed: Equal seeds give equal maps.
        cache_dir: Folder of the cache; None: no cache.

    Raises:
        InvalidInputError: There is no set of that name.
    """
    if name not in RECIPES:
        raise InvalidInputError("texture", name, f"one of {', '.join(sorted(TEXTURES))}")
    if cache_dir is None:
        return make_texture_set(name, size_px, seed)
    key = hashlib.sha256(repr((RECIPES[name].version, name, size_px, seed)).encode()).hexdigest()
    path = cache_dir / f"{name}-{key[:16]}.npz"
    cached = _read(path, name)
    if cached is None:
        cached = make_texture_set(name, size_px, seed)
        _write(path, cached)
    return cached


def make_texture_set(name: str, size_px: int, seed: int) -> PbrMaps:
    """Return a built-in texture set, made anew."""
    recipe = RECIPES[name]
    surface = recipe.make(size_px, randomness.stream(seed, f"texture/{name}"))
    low, high = float(surface.height.min()), float(surface.height.max())
    relief = max(high - low, 1e-9)
    height = ((surface.height - np.float32(low)) / np.float32(relief)).astype(np.float32)
    return PbrMaps(
        name=name,
        color_srgb=np.rint(surface.color * 255).astype(np.uint8),
        height=height,
        normal_gl=normals_from_height(height, relief * recipe.tile_m, recipe.tile_m),
        roughness=np.rint(surface.roughness * 255).astype(np.uint8),
        tile_m=recipe.tile_m,
    )


def default_cache_dir() -> Path | None:
    """Return the user's cache folder (XDG_CACHE_HOME, or ~/.cache), None if it is not writable."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (Path(base) if base else Path.home() / ".cache") / "oaisys" / "textures"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return folder if os.access(folder, os.W_OK) else None


def _read(path: Path, name: str) -> PbrMaps | None:
    try:
        with np.load(path) as maps:
            return PbrMaps(
                name=name,
                color_srgb=maps["color_srgb"],
                height=maps["height"],
                normal_gl=maps["normal_gl"],
                roughness=maps["roughness"],
                tile_m=float(maps["tile_m"]),
            )
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        LOG.warning("the cached texture %s is not readable and is made again: %s", path, error)
        return None


def _write(path: Path, maps: PbrMaps) -> None:
    """Write a cache file so that other processes see all of it or nothing."""
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            np.savez(
                file,
                color_srgb=maps.color_srgb,
                height=maps.height,
                normal_gl=maps.normal_gl,
                roughness=maps.roughness,
                tile_m=maps.tile_m,
            )
        Path(file.name).replace(path)
    except OSError as error:
        LOG.warning("the texture cache %s cannot be written: %s", path, error)
