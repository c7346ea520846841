"""Backends by name; each is imported only when it is chosen."""

from __future__ import annotations

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.render.base import Backend

BACKENDS = ("blender", "analytic")


def make_backend(name: str) -> Backend:
    """Return a new backend.

    Raises:
        InvalidInputError: There is no backend of that name.
        BackendUnavailableError: It cannot run here, for instance without ``bpy``.
    """
    if name == "blender":
        from oaisys_core.render.blender import BlenderBackend

        return BlenderBackend()
    if name == "analytic":
        from oaisys_core.render.analytic import AnalyticBackend

        return AnalyticBackend()
    raise InvalidInputError("backend", name, one_of(BACKENDS, name))
