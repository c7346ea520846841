"""Tileable PBR texture sets, generated from a seed or read from a folder of maps."""

from oaisys_core.procedural.textures.cache import default_cache_dir
from oaisys_core.procedural.textures.folder import load_texture_folder
from oaisys_core.procedural.textures.library import (
    TEXTURES,
    TEXTURES_WITH_STONES,
    stands_out,
    texture_exposure,
    texture_set,
    texture_stones,
)

__all__ = [
    "TEXTURES",
    "TEXTURES_WITH_STONES",
    "default_cache_dir",
    "load_texture_folder",
    "stands_out",
    "texture_exposure",
    "texture_set",
    "texture_stones",
]
