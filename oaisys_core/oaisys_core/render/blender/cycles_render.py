"""One render by Cycles, as quick as its add-on allows, or by Blender's own means without that."""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import cycles
import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.output.exr import read_channels
from oaisys_core.private.c_output import without_c_output
from oaisys_core.private.cycles_addon import engine_of, session_of, wrap_methods
from oaisys_core.private.cycles_log import collect_errors
from oaisys_core.private.cycles_session import end_sampling
from oaisys_core.render.blender.compat import IS_BLENDER_5
from oaisys_core.render.render_result import RenderResult
from oaisys_core.system.ending.interruption import stop_if_unwanted, stop_when_unwanted

_SAMPLE = re.compile(r"Sample (\d+)/\d+")

READ_ALWAYS = {"samples", "time_limit"}
"""Settings that Cycles reads before each render; the others need an update of the scene."""

CHANNELS = "RGBAXYZWUV"
"""Order of a pass's channels by their letters in an EXR file."""


def render_scene(settings: Mapping[str, Any]) -> RenderResult:
    """Render the scene's camera with settings of Cycles, by their names in ``scene.cycles``.

    Raises:
        RenderError: Blender failed, or Cycles logged an error.
        OaisysError: The render was no longer wanted.
    """
    _write(settings, bpy.context.scene.cycles)
    rendered = RenderResult()
    engine = engine_of(cycles)
    try:
        with _counted(rendered), without_c_output():
            if engine is None:
                _render_to_file(rendered)
            else:
                _render_directly(rendered, settings, engine)
    except RuntimeError as error:
        raise RenderError(f"Blender could not render: {error}") from error
    if rendered.errors:
        raise RenderError(f"Cycles: {'; '.join(rendered.errors)}")
    stop_if_unwanted()
    return rendered


def _render_directly(
    rendered: RenderResult, settings: Mapping[str, Any], engine: type[Any]
) -> None:
    """Render, with the methods of the Cycles add-on wrapped.

    Blender renders an evaluated copy of the scene, and copies changed settings only if the whole
    scene is marked as changed, after which Cycles updates every object. Settings are therefore
    written into the copy as well.
    """

    def on_update(update: Callable[[], None], depsgraph: Any) -> None:
        if not _write(settings, depsgraph.scene_eval.cycles) and _only_camera_moved(depsgraph):
            # Where the scene is marked as changed, Cycles visits every object and instance. This
            # clears the marks. Cycles updates the camera in any case.
            depsgraph.update()
        with collect_errors(bpy.app.version) as errors:
            update()
        rendered.errors += errors

    def on_render(render: Callable[[], None], running: Any) -> None:
        def stop() -> None:
            # Before, Cycles copies the scene, which it keeps for the next render.
            if rendered.sampling_began_s:
                end_sampling(session_of(running), bpy.app.version)

        with collect_errors(bpy.app.version) as errors, stop_when_unwanted(stop):
            render()
        rendered.errors += errors
        result = running.get_result()
        if result is not None:
            rendered.passes = _passes_of(result)

    with wrap_methods(engine, on_update, on_render):
        bpy.ops.render.render()


def _render_to_file(rendered: RenderResult) -> None:
    """Render all changes of the scene, and read the passes from an EXR file."""
    scene = bpy.context.scene
    scene.update_tag()
    image = scene.render.image_settings
    if IS_BLENDER_5:
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    image.exr_codec = "NONE"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "passes.exr")
        scene.render.filepath = str(file)
        with collect_errors(bpy.app.version) as errors:
            bpy.ops.render.render(write_still=True)
        rendered.errors += errors
        rendered.passes = _passes_of_channels(read_channels(file, all_parts=True))


def _passes_of_channels(channels: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[np.float32]]:
    """Return passes from channels that are named ``layer.pass.letter``."""
    of_passes: dict[str, dict[str, NDArray[Any]]] = {}
    for name, values in channels.items():
        *_, passed, letter = name.split(".")
        of_passes.setdefault(passed, {})[letter] = values
    return {
        name: np.stack([letters[each] for each in sorted(letters, key=CHANNELS.find)], axis=-1)
        for name, letters in of_passes.items()
    }


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
