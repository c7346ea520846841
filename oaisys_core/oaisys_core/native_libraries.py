"""Lets Open3D and ``bpy`` be imported in either order.

Both bring a ``libtbb.so.12``, and a process has but one of that name: the first. With Python 3.13
Blender's is newer, and ``bpy`` cannot be imported with Open3D's. The guard loads Blender's, where
``bpy`` is installed, just before Open3D is imported; Open3D gets on with either.
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
    """Finds no module; before Open3D is looked for, it loads Blender's library."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> None:
        """Load the library where ``fullname`` is Open3D; all is left to other finders."""
        if fullname == "open3d":
            load_blenders()


def guard_open3d() -> None:
    """Install the guard, once."""
    if not any(isinstance(finder, Open3DGuard) for finder in sys.meta_path):
        sys.meta_path.insert(0, Open3DGuard())


def load_blenders() -> Path | None:
    """Load the library that ``bpy`` brings; return it, None where there is none to load."""
    found = find_spec("bpy")
    for folder in (found.submodule_search_locations if found else None) or ():
        library = Path(folder, "lib", LIBRARY)
        if library.is_file():
            CDLL(str(library))
            return library
    return None
