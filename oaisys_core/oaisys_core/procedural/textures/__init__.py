"""Tileable PBR texture sets, generated from a seed or read from a folder of maps."""

from oaisys_core.procedural.textures.cache import default_cache_dir
from oaisys_core.procedural.textures.folder import load_texture_folder
from oaisys_core.procedural.textures.library import TEXTURES, texture_exposure, texture_set

__all__ = [
    "TEXTURES",
    "default_cache_dir",
    "load_texture_folder",
    "texture_exposure",
    "texture_set",
]
