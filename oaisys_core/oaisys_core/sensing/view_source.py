"""Where a sample's images come from: the cache of views, or the backend."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from oaisys_core.backend.base import Backend, FramesCallback, ProgressCallback, RenderSettings
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.sensing.faults import DepthFaults, Shot, measured_frame
from oaisys_core.sensing.view_cache import PoseCache, View
from oaisys_core.types import (
    DEPTH,
    RANGE,
    RGB,
    Frame,
    FrameName,
    SampleFramesCallback,
    SampleOutline,
    early_first,
)

NO_FAULTS = DepthFaults()

FramesPlacement = Callable[[tuple[Frame, ...]], tuple[Frame, ...]]


def leave_frames(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    """Return frames where they are."""
    return frames


class Seen(NamedTuple):
    """What was seen, and when the last of it was there (`time.monotonic_ns`)."""

    view: View
    finished_ns: int
    from_cache: bool


def _have_depth(cameras: Sequence[PlacedCamera]) -> bool:
    return any({DEPTH, RANGE}.intersection(camera.modalities) for camera in cameras)


class ViewSource:
    """Gives views of the world that the backend was given, each rendered once where it is kept."""

    def __init__(
        self, backend: Backend, cache_bytes: int = 0, place_frames: FramesPlacement = leave_frames
    ) -> None:
        """Keep no view yet; see `Simulation` for the arguments."""
        self._backend = backend
        self._views = PoseCache(cache_bytes)
        self._place_frames = place_frames

    def forget_world(self) -> None:
        """Let go of the world of the last view; views of it are kept."""
        self._views.forget_world()

    def see(
        self,
        outline: SampleOutline,
        scene: Scene,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
        on_frames: SampleFramesCallback,
        faults: DepthFaults = NO_FAULTS,
    ) -> Seen:
        """Return what cameras see of the backend's world, which is ``scene``.

        Args:
            outline: Of the sample; whether it is from the cache is found out here.
            progress: Told how far a render is; may raise `CancelledError`.
            on_frames: Told each frame once, as soon as it is ready.
            faults: What sensors get wrong about depth; such views are never kept, for no two
                samples have the same noise.
        """
        key = None
        if not (faults.active and _have_depth(cameras)):
            key = self._views.key(outline.provenance, scene, cameras, settings)
        view = self._views.get(key)
        outline = replace(outline, from_cache=view is not None)
        if view is not None:
            finished_ns = time.monotonic_ns()
            on_frames(outline, early_first(view.frames))
            self._backend.revisited(cameras)
        else:
            shots = {c.name: Shot(outline.batch_id, outline.sample_id, c.name) for c in cameras}
            view, finished_ns = self._rendered(
                cameras,
                settings,
                progress,
                lambda frames: on_frames(outline, frames),
                lambda frame: measured_frame(frame, faults, shots[frame.sensor]),
            )
            self._views.add(key, view)
        return Seen(view, finished_ns, outline.from_cache)

    def _rendered(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
        on_frames: FramesCallback,
        measured: Callable[[Frame], Frame],
    ) -> tuple[View, int]:
        """Return what is seen, and when the last of it was there (`time.monotonic_ns`)."""
        placed: dict[FrameName, Frame] = {}
        finished_ns = 0

        def hand_on(ready: tuple[Frame, ...]) -> None:
            nonlocal finished_ns
            finished_ns = time.monotonic_ns()
            ready = self._place_frames(tuple(map(measured, ready)))
            placed.update((FrameName(frame.sensor, frame.modality), frame) for frame in ready)
            on_frames(ready)

        rendered = self._backend.render(cameras, settings, progress, hand_on)
        frames = tuple(placed[FrameName(frame.sensor, frame.modality)] for frame in rendered)
        if not any(RGB in camera.modalities for camera in cameras):
            return View(frames, render_samples=0), finished_ns
        return View(frames, self._backend.samples_per_pixel or settings.samples), finished_ns
