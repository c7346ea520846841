"""Built-in texture sets by name, cached because they take seconds to make."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.procedural.textures import cache
from oaisys_core.procedural.textures.code_version import code_version
from oaisys_core.procedural.textures.fields import normals_from_height
from oaisys_core.procedural.textures.recipes import (
    clay,
    earth,
    frozen,
    grass,
    litter,
    loose,
    moss,
    rocks,
    salt,
    snow,
    wind_ripples,
)
from oaisys_core.procedural.textures.recipes.finish import Recipe, TextureMaps
from oaisys_core.scene import PbrMaps

RECIPES: dict[str, Recipe] = {
    **loose.RECIPES,
    **rocks.RECIPES,
    **clay.RECIPES,
    **earth.RECIPES,
    **grass.RECIPES,
    **moss.RECIPES,
    **litter.RECIPES,
    **frozen.RECIPES,
    **salt.RECIPES,
    **snow.RECIPES,
    **wind_ripples.RECIPES,
}

TEXTURES = frozenset(RECIPES)

TEXTURES_WITH_STONES = frozenset(name for name, recipe in RECIPES.items() if recipe.has_stones)
"""Texture sets of which `texture_stones` can tell the stones from the ground."""


def texture_set(name: str, size_px: int | None, seed: int, cache_dir: Path | None) -> PbrMaps:
    """Return a built-in texture set, from the cache if the same code has put it there.

    Args:
        name: One of `TEXTURES`.
        size_px: Edge length of its maps; None: as large as its recipe says.
        seed: Seed of the maps.
        cache_dir: Folder of the cache; None for no cache.

    Raises:
        InvalidInputError: There is no set of that name.
    """
    if name not in RECIPES:
        raise InvalidInputError("texture", name, one_of(TEXTURES, name))
    size_px = size_px or RECIPES[name].size_px
    if cache_dir is None:
        return make_texture_set(name, size_px, seed)
    subsurface = RECIPES[name].subsurface
    key = hashlib.sha256(repr((code_version(), name, size_px, seed)).encode()).hexdigest()
    path = cache_dir / f"{name}-{key[:16]}.npz"
    cached = cache.read(path, name, size_px)
    if cached is None:
        cached = make_texture_set(name, size_px, seed)
        cache.write(path, cached)
    return replace(cached, subsurface=subsurface) if subsurface else cached


@lru_cache(maxsize=4)
def texture_stones(name: str, size_px: int | None, seed: int) -> NDArray[np.uint32]:
    """Return which stone each pixel of a built-in texture set shows; it is made anew for this.

    Args:
        name: One of `TEXTURES_WITH_STONES`.
        size_px: Edge length of its maps; None: as large as its recipe says.
        seed: Seed of the maps.

    Returns:
        (N, N) numbers of stones, from 1; 0 is the ground between them. Row 0 is the top of the
        image, as in `PbrMaps`. Not to be changed.

    Raises:
        InvalidInputError: There is no such set, or it has no stones.
    """
    if name not in TEXTURES_WITH_STONES:
        raise InvalidInputError("texture", name, one_of(TEXTURES_WITH_STONES, name))
    stones = _make(name, size_px or RECIPES[name].size_px, seed).stones
    if stones is None:
        raise InvalidInputError("texture", name, "a texture set whose recipe makes stones")
    return stones


def texture_exposure(name: str) -> float:
    """Return where the ground of a built-in texture set lies, see `Recipe`."""
    return RECIPES[name].exposure


def stands_out(name: str) -> bool:
    """Return whether one sees that a built-in texture set repeats, see `Recipe`."""
    return RECIPES[name].stands_out


def make_texture_set(name: str, size_px: int, seed: int) -> PbrMaps:
    """Make a built-in texture set."""
    recipe, made = RECIPES[name], _make(name, size_px, seed)
    low, high = float(made.height.min()), float(made.height.max())
    relief = max(high - low, 1e-9)
    height = ((made.height - np.float32(low)) / np.float32(relief)).astype(np.float32)
    return PbrMaps(
        name=name,
        color_srgb=np.rint(made.color * 255).astype(np.uint8),
        height=height,
        normal_gl=normals_from_height(height, relief * recipe.tile_m, recipe.tile_m),
        roughness=np.rint(made.roughness * 255).astype(np.uint8),
        tile_m=recipe.tile_m,
        subsurface=recipe.subsurface,
    )


def _make(name: str, size_px: int, seed: int) -> TextureMaps:
    return RECIPES[name].make(size_px, randomness.stream(seed, f"texture/{name}"))
