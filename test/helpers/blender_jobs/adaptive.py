"""What tests of adaptive samples have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from synthetic_worlds import settings

from oaisys_core.render.blender import BlenderBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import ALBEDO, RGB


def pictures(scenes: Sequence[Scene], view: PlacedCamera) -> list[dict[str, Any]]:
    """Worlds with two to four samples per pixel, and the last one with four."""
    view = replace(view, modalities=(RGB,))
    range_ = replace(settings(2), denoise=True, max_samples=4)
    backend = BlenderBackend()
    found = []
    for scene in scenes:
        backend.build(scene, lambda _: None)
        found.append(_picture(backend, view, range_))
    return [*found, _picture(backend, view, replace(range_, samples=4))]


def albedos(scene: Scene, view: PlacedCamera) -> list[Any]:
    """The albedo of a world beside colour, and alone, with two to four samples per pixel."""
    how = replace(settings(2), denoise=True, max_samples=4)
    backend = BlenderBackend()
    backend.build(scene, lambda _: None)
    wanted = [replace(view, modalities=each) for each in ((RGB, ALBEDO), (ALBEDO,))]
    return [backend.render_all([each], how, lambda _: None)[-1].data for each in wanted]


def _picture(backend: BlenderBackend, view: PlacedCamera, how: Any) -> dict[str, Any]:
    (frame,) = backend.render_all([view], how, lambda _: None)
    return {"samples": backend.samples_per_pixel, "picture": frame.data}
