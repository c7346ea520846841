"""Renders with Cycles without a scene update for each setting, and reads pixels without a file."""

from __future__ import annotations

import ctypes
import functools
import logging
import os
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
from cycles import CyclesRender
from numpy.typing import NDArray

_SAMPLE = re.compile(r"Sample (\d+)/\d+")

READ_ALWAYS = {"samples", "time_limit"}
"""Settings that Cycles reads before each render; the others need an update of the scene."""


@dataclass
class RenderResult:
    """Passes and statistics of a render.

    Attributes:
        passes: (H, W, channels) scene-linear float32 by Blender's name, top row first.
        samples: Samples per pixel that were taken; 0: not reported.
        sampling_began_s, sampling_ended_s: By `time.perf_counter`; 0: not reported.
    """

    passes: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    samples: int = 0
    sampling_began_s: float = 0.0
    sampling_ended_s: float = 0.0


def render_scene(settings: Mapping[str, Any]) -> RenderResult:
    """Render the scene's camera with settings of Cycles, by their names in ``scene.cycles``.

    Blender renders an evaluated copy of the scene, and copies changed settings only if the whole
    scene is marked as changed, after which Cycles updates every object. Settings are therefore
    written into the copy as well.

    Raises:
        RuntimeError: Blender failed.
    """
    _write(settings, bpy.context.scene.cycles)
    rendered = RenderResult()
    with _intercepted(settings, rendered), _counted(rendered), _without_c_output():
        bpy.ops.render.render()
    return rendered


@contextmanager
def _intercepted(settings: Mapping[str, Any], rendered: RenderResult) -> Iterator[None]:
    """Wrap the two methods of the Cycles add-on that Blender calls during a render."""
    update, render = CyclesRender.update, CyclesRender.render

    def update_with_settings(engine: Any, data: Any, depsgraph: Any) -> None:
        if not _write(settings, depsgraph.scene_eval.cycles) and _only_camera_moved(depsgraph):
            # Clears the marks of change, for which Cycles would visit every object and instance;
            # it updates the camera in any case.
            depsgraph.update()
        update(engine, data, depsgraph)

    def render_and_read(engine: Any, depsgraph: Any) -> None:
        render(engine, depsgraph)
        result = engine.get_result()
        if result is not None:
            rendered.passes = _passes_of(result)

    CyclesRender.update, CyclesRender.render = update_with_settings, render_and_read
    try:
        yield
    finally:
        CyclesRender.update, CyclesRender.render = update, render


def _write(settings: Mapping[str, Any], cycles: Any) -> bool:
    """Set what differs, and return whether Cycles must update the scene for it."""
    changed = [name for name, value in settings.items() if getattr(cycles, name) != value]
    for name in changed:
        setattr(cycles, name, settings[name])
    return bool(set(changed) - READ_ALWAYS)


def _only_camera_moved(depsgraph: Any) -> bool:
    """Return whether nothing but the camera and its lens is marked as changed."""
    scene = depsgraph.scene_eval
    if scene.render.use_motion_blur:
        return False
    camera = scene.camera
    known = {camera.original, camera.data.original}
    return all(update.id.original in known for update in depsgraph.updates)


def _passes_of(result: Any) -> dict[str, NDArray[np.float32]]:
    passes = {}
    for layer in result.layers:
        for given in layer.passes:
            pixels = np.empty(
                result.resolution_x * result.resolution_y * given.channels, np.float32
            )
            given.rect.foreach_get(pixels)
            shape = (result.resolution_y, result.resolution_x, given.channels)
            passes[given.name] = pixels.reshape(shape)[::-1]
    return passes


@contextmanager
def _counted(rendered: RenderResult) -> Iterator[None]:
    """Record the number and times of samples that Cycles reports while it renders."""

    def read(text: str, *_: Any) -> None:
        counted = _SAMPLE.search(str(text))
        if counted is None:
            return
        samples = int(counted[1])
        if not rendered.sampling_began_s:
            rendered.sampling_began_s = rendered.sampling_ended_s = time.perf_counter()
        # After the last sample, Cycles reports from 1 again.
        if samples > rendered.samples:
            rendered.samples, rendered.sampling_ended_s = samples, time.perf_counter()

    bpy.app.handlers.render_stats.append(read)
    try:
        yield
    finally:
        bpy.app.handlers.render_stats.remove(read)


@contextmanager
def _without_c_output() -> Iterator[None]:
    """Drop the output of C code, but not that of Python in any thread.

    Blender 4.5 prints a line for each step of a render and has no option against it. This replaces
    the stream of the C library and not file descriptor 1, which belongs to the program. If debug
    logging is on, the output goes to standard error.
    """
    streams = _c_streams()
    if streams is None:
        yield
        return
    output, errors, nowhere = streams
    kept = output.value
    output.value = errors.value if logging.getLogger().isEnabledFor(logging.DEBUG) else nowhere
    try:
        yield
    finally:
        output.value = kept


@functools.cache
def _c_streams() -> tuple[ctypes.c_void_p, ctypes.c_void_p, int] | None:
    """Return the C library's stdout and stderr, and a null stream; None if it has other names."""
    library = ctypes.CDLL(None)
    try:
        output = ctypes.c_void_p.in_dll(library, "stdout")
        errors = ctypes.c_void_p.in_dll(library, "stderr")
    except ValueError:
        return None
    library.fopen.restype = ctypes.c_void_p
    nowhere = library.fopen(os.devnull.encode(), b"w")
    return None if nowhere is None else (output, errors, int(nowhere))
