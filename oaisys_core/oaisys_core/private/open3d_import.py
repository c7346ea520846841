"""Open3D's import: after Blender's library of the same name, and in half of its time.

Open3D and ``bpy`` both contain a ``libtbb.so.12``, and a process can only load one library of that
name. With Python 3.13, Blender's is newer, and ``bpy`` cannot be imported after Open3D has loaded
its own. If ``bpy`` is installed, an import hook loads Blender's library just before Open3D is
imported; Open3D works with both. Open3D imports a web framework, Dash, for a function that draws
meshes with Plotly. The hook puts that off until somebody calls the function. Open3D expects
libusb of the system; where there is none, the hook loads that of the package libusb-package.

Private part: the file ``lib/libtbb.so.12`` in ``bpy``, and Open3D's module
    ``open3d.visualization.draw_plotly`` with the functions that Open3D imports from it.
Tried with: Open3D 0.20.0 beside bpy 4.5.15 and 5.2.3.
Public way without it: both are imported as usual; ``bpy`` must come first.
Lost without it: either order of imports (an error says so), and 1.6 s and 33 MB for each import.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from ctypes import CDLL
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from oaisys_core.system.fallbacks import report_fallback

LIBRARY = "libtbb.so.12"
LIBUSB = "libusb-1.0.so.0"
PLOTS = "open3d.visualization.draw_plotly"
PLOT_FUNCTIONS = "get_plotly_fig", "draw_plotly", "draw_plotly_server"
"""What Open3D imports from `PLOTS` when it is imported itself."""


class Open3DGuard:
    """An import hook that prepares the import of Open3D; but for `PLOTS` it finds no modules.

    It has no base class of `importlib.abc`, whose import takes half of the time of ours.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Load the library if ``fullname`` is Open3D; other finders do the import."""
        if fullname == "open3d":
            load_blender_library()
            load_libusb()
            _check_plots()
        if fullname == PLOTS and (found := PathFinder.find_spec(fullname, path)) is not None:
            loader: Any = _DeferredPlots(found)
            return ModuleSpec(fullname, loader)
        return None


class _DeferredPlots:
    """Loads a module whose functions import what they need when they are called."""

    def __init__(self, spec: ModuleSpec) -> None:
        self._spec = spec
        self._plots: ModuleType | None = None

    def create_module(self, _: ModuleSpec) -> None:
        """Leave it to Python."""

    def exec_module(self, module: ModuleType) -> None:
        for name in PLOT_FUNCTIONS:
            setattr(module, name, self._defer(name))
        module.__getattr__ = self._attribute  # type: ignore[method-assign]

    def _defer(self, name: str) -> Callable[..., Any]:
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


def _check_plots() -> None:
    """Report an Open3D without `PLOTS`."""
    found = PathFinder.find_spec("open3d")
    folders = (found.submodule_search_locations if found else None) or ()
    names = PLOTS.split(".")[1:]
    if folders and not any(Path(folder, *names).with_suffix(".py").is_file() for folder in folders):
        reason, instead = f"there is no {PLOTS}", "its import takes a second longer, for Dash"
        report_fallback("Open3D's module that imports Dash", reason, instead)


def load_libusb() -> None:
    """Load libusb, the system's or the package's; report where there is neither."""
    with suppress(OSError):
        CDLL(LIBUSB)
        return
    found = find_spec("libusb_package")
    for folder in (found.submodule_search_locations if found else None) or ():
        if (library := Path(folder, "libusb-1.0.so")).is_file():
            CDLL(str(library))
            return
    reason, instead = f"there is no {LIBUSB}", "Open3D needs it: `pip install libusb-package`"
    report_fallback("libusb", reason, instead)


def load_blender_library() -> Path | None:
    """Load the library of ``bpy`` and return its path, or None if there is none."""
    found = find_spec("bpy")
    for folder in (found.submodule_search_locations if found else None) or ():
        library = Path(folder, "lib", LIBRARY)
        if library.is_file():
            CDLL(str(library))
            return library
    return None
