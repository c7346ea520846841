"""Lets Open3D and ``bpy`` be imported in either order, and Open3D in half of its time.

Both contain a ``libtbb.so.12``, and a process can only load one library of that name. With Python
3.13, Blender's is newer, and ``bpy`` cannot be imported after Open3D has loaded its own. If ``bpy``
is installed, the guard loads Blender's library just before Open3D is imported; Open3D works with
both.

Open3D imports a web framework, Dash, for a function that draws meshes with Plotly. The guard puts
that off until somebody calls the function.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from ctypes import CDLL
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec, module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any

LIBRARY = "libtbb.so.12"
PLOTS = "open3d.visualization.draw_plotly"
PLOT_FUNCTIONS = "get_plotly_fig", "draw_plotly", "draw_plotly_server"
"""What Open3D imports from `PLOTS` when it is imported itself."""


class Open3DGuard(MetaPathFinder):
    """An import hook that prepares the import of Open3D; but for `PLOTS` it finds no modules."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Load the library if ``fullname`` is Open3D; other finders do the import."""
        if fullname == "open3d":
            load_blender_library()
        if fullname == PLOTS and (found := PathFinder.find_spec(fullname, path)) is not None:
            return spec_from_loader(fullname, _DeferredPlots(found))
        return None


class _DeferredPlots(Loader):
    """Loads a module whose functions import what they need when they are called."""

    def __init__(self, spec: ModuleSpec) -> None:
        self._spec = spec
        self._plots: ModuleType | None = None

    def exec_module(self, module: ModuleType) -> None:
        for name in PLOT_FUNCTIONS:
            setattr(module, name, self._deferred(name))
        module.__getattr__ = self._attribute  # type: ignore[method-assign]

    def _deferred(self, name: str) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            return self._attribute(name)(*arguments, **options)

        return call

    def _attribute(self, name: str) -> Any:
        if name.startswith("__"):  # such as those that the import itself looks for
            raise AttributeError(name)
        if self._plots is None:
            plots = module_from_spec(self._spec)
            assert self._spec.loader is not None
            self._spec.loader.exec_module(plots)
            self._plots = plots
        return getattr(self._plots, name)


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
