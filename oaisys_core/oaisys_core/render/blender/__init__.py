"""The Blender backend, the only place where ``bpy`` is imported.

Raises:
    BackendUnavailableError: ``bpy`` cannot be imported here.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from oaisys_core.errors import BackendUnavailableError
from oaisys_core.system.current_folder import in_root_folder
from oaisys_core.system.ending.leftovers import keep_temporary_files

try:
    keep_temporary_files()
    # Its library for sound loads whatever lies in the folder "plugins" of the current one.
    with in_root_folder():
        import bpy as _bpy  # noqa: F401
except ImportError as error:
    hint = (
        "open3d was imported before oaisys_core and bpy, and loaded an older library of the same "
        "name (libtbb): import oaisys_core, or bpy, before open3d"
        if "open3d" in sys.modules
        else "install bpy 4.5 (Python 3.11) or 5.2 (Python 3.13), or name an interpreter that has "
        "it (--worker-python), or choose the analytic backend"
    )
    raise BackendUnavailableError(f"bpy cannot be imported ({error}): {hint}") from error

if TYPE_CHECKING:
    from oaisys_core.render.blender.renderer import BlenderBackend

__all__ = ["BlenderBackend"]


def __getattr__(name: str) -> Any:
    """Import the backend when it is wanted: who reads a .blend file needs Blender alone."""
    if name == "BlenderBackend":
        from oaisys_core.render.blender.renderer import BlenderBackend

        return BlenderBackend
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
