"""Two methods of the Cycles add-on that Blender calls during each render.

Private part: ``CyclesRender.update`` and ``.render`` in the add-on's module ``cycles``, which are
    wrapped, and the attribute ``session`` of their object.
Tried with: bpy 4.5.15 and 5.2.3.
Public way without it: the scene is marked as changed before each render, and its passes are read
    from an EXR file. The pictures are the same.
Lost without it: time, 1 s for each change of settings or camera and 30 ms for the file; and renders
    that are no longer wanted cannot be ended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from oaisys_core.system.fallbacks import report_fallback

ENGINE, UPDATE, RENDER = "CyclesRender", "update", "render"
"""Names of the class in the add-on's module, and of its methods."""

OnUpdate = Callable[[Callable[[], None], Any], None]
"""Receives the add-on's own update, to be called, and the dependency graph that it updates from."""

OnRender = Callable[[Callable[[], None], Any], None]
"""Receives the add-on's own render, to be called, and the engine that renders."""


def engine_of(addon: Any) -> type[Any] | None:
    """Return the add-on's engine; None if it has other methods than expected."""
    engine: type[Any] | None = getattr(addon, ENGINE, None)
    missing = [each for each in (UPDATE, RENDER) if not hasattr(engine, each)]
    if not missing:
        return engine
    instead = "pictures take a second longer, and no render can be ended but with its worker"
    report_fallback("The Cycles add-on", f"its {ENGINE} has no {' and no '.join(missing)}", instead)
    return None


def session_of(engine: Any) -> int:
    """Return the address of the session in which an engine renders; 0: unknown."""
    return int(getattr(engine, "session", 0) or 0)


@contextmanager
def wrap_methods(engine: type[Any], on_update: OnUpdate, on_render: OnRender) -> Iterator[None]:
    """Have an engine's renders within the block call these instead of its own methods."""
    update, render = getattr(engine, UPDATE), getattr(engine, RENDER)

    def wrapped_update(self: Any, data: Any, depsgraph: Any) -> None:
        on_update(lambda: update(self, data, depsgraph), depsgraph)

    def wrapped_render(self: Any, depsgraph: Any) -> None:
        on_render(lambda: render(self, depsgraph), self)

    setattr(engine, UPDATE, wrapped_update)
    setattr(engine, RENDER, wrapped_render)
    try:
        yield
    finally:
        setattr(engine, UPDATE, update)
        setattr(engine, RENDER, render)
