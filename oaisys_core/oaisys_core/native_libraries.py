"""Lets Open3D and ``bpy`` be imported in either order.

Both contain a ``libtbb.so.12``, and a process can only load one library of that name. With Python
3.13, Blender's is newer, and ``bpy`` cannot be imported after Open3D has loaded its own. If ``bpy``
is installed, the guard loads Blender's library just before Open3D is imported; Open3D works with
both.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from ctypes import CDLL
from importlib.abc import MetaPathFinder
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

LIBRARY = "libtbb.so.12"


class Open3DGuard(MetaPathFinder):
    """An import hook that loads Blender's library before Open3D; it finds no modules itself."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> None:
        """Load the library if ``fullname`` is Open3D; other finders do the import."""
        if fullname == "open3d":
            load_blender_library()


def guard_open3d() -> None:
    """Install the import hook if it is not installed yet."""
    if not any(isinstance(finder, Open3DGuard) for finder in sys.meta_path):
        sys.meta_path.insert(0, Open3DGuard())


def load_blender_library() -> Path | None:
    """Load the library of ``bpy`` and return its path, or None if there is none."""
    found = find_spec("bpy")
    for folder in (found.submodule_search_locations if found else None) or ():
        library = Path(folder, "lib", LIBRARY)
        if library.is_file():
            CDLL(str(library))
            return library
    return None
