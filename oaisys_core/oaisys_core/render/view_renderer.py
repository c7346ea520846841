"""Gets a sample's frames from the cache of views or from the backend, and its scans."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from functools import partial

from oaisys_core.errors import RenderError
from oaisys_core.render.base import Backend, FrameGroup
from oaisys_core.render.view_cache import RenderedView, ViewCache
from oaisys_core.scene import PlacedCamera, PlacedLidar, Scene
from oaisys_core.sensing.faults import CaptureId, DepthFaults, measure_frame
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import (
    DEPTH,
    LIT,
    POINTS,
    RANGE,
    Frame,
    FrameName,
    ProgressCallback,
    Sample,
    SampleOutline,
    early_first,
)

FramesPlacement = Callable[[tuple[Frame, ...]], tuple[Frame, ...]]

SampleSteps = Generator[tuple[SampleOutline, FrameGroup], None, Sample]
"""Yields groups of a sample's frames with the sample's outline; returns the complete sample."""


def leave_frames(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    """Return the frames as they are."""
    return frames


class ViewRenderer:
    """Renders views of the backend's world, or returns them from the cache."""

    def __init__(
        self, backend: Backend, cache_bytes: int = 0, place_frames: FramesPlacement = leave_frames
    ) -> None:
        """Start with an empty cache; see `Simulation` for the arguments."""
        self._backend = backend
        self._cache = ViewCache(cache_bytes)
        self._place_frames = place_frames

    def forget_world(self) -> None:
        """Let go of the world of the last view; its cached views are kept."""
        self._cache.forget_world()

    def sample(
        self,
        outline: SampleOutline,
        scene: Scene,
        cameras: Sequence[PlacedCamera],
        lidars: Sequence[PlacedLidar],
        settings: RenderSettings,
        progress: ProgressCallback,
        faults: DepthFaults | None,
        fault_batch: int,
        started_s: float,
    ) -> SampleSteps:
        """Render what sensors see of ``scene``, which the backend was given.

        Scans come first, because they take a fraction of an image's time; they are not cached.

        Args:
            outline: Of the sample; whether it comes from the cache is set here.
            faults: Errors of depth sensors, if any. Views with such errors are not cached, because
                no two samples have the same noise.
            fault_batch: Number of the batch from which they are drawn.
            started_s: When the sample began, by `time.perf_counter`.
        """
        key = None
        if faults is None or not _have_depth(cameras):
            key = self._cache.key(outline.provenance, scene, cameras, settings)
        view = self._cache.get(key)
        outline = replace(outline, from_cache=view is not None)
        capture_of = partial(CaptureId, fault_batch, outline.sample_id)
        scans = tuple(self._backend.scan(each, capture_of(each.name)) for each in lidars)
        if scans:
            yield outline, FrameGroup.of((), scans)
        finished_ns = time.monotonic_ns()
        if view is not None:
            yield outline, FrameGroup.of(early_first(view.frames))
            self._backend.note_revisit(cameras)
        else:
            groups = []
            for rendered in self._backend.render(cameras, settings, progress):
                finished_ns = time.monotonic_ns()
                groups.append(rendered.map_frames(lambda f: self._measure(f, faults, capture_of)))
                yield outline, groups[-1]
            view = self._collect_view(outline, groups, settings)
            self._cache.add(key, view)
        return Sample(
            batch_id=outline.batch_id,
            sample_id=outline.sample_id,
            rig_pose=outline.rig_pose,
            frames=view.frames,
            render_time_s=time.perf_counter() - started_s,
            provenance=replace(
                outline.provenance,
                render_samples=view.render_samples,
                exposures_json=view.exposures_json,
                device=self._backend.device,  # may have been chosen by this very render
            ),
            from_cache=outline.from_cache,
            finished_ns=finished_ns,
            odometry=outline.odometry,
            scans=scans,
        )

    def _measure(
        self,
        frames: tuple[Frame, ...],
        faults: DepthFaults | None,
        capture_of: Callable[[str], CaptureId],
    ) -> tuple[Frame, ...]:
        """Return what sensors measure instead of the true frames, placed where frames are kept."""
        if faults is not None:
            frames = tuple(measure_frame(each, faults, capture_of(each.sensor)) for each in frames)
        return self._place_frames(frames)

    def _collect_view(
        self, outline: SampleOutline, groups: Sequence[FrameGroup], settings: RenderSettings
    ) -> RenderedView:
        """Wait for all groups and return their frames in the outline's order."""
        by_name = {FrameName(f.sensor, f.modality): f for g in groups for f in g.result()}
        wanted = [name for name in outline.frames if name.modality != POINTS]
        for name in wanted:
            if name not in by_name:
                raise RenderError(f"{name.sensor}: its {name.modality} was not rendered")
        frames = tuple(by_name[name] for name in wanted)
        samples = self._backend.samples_per_pixel or settings.samples
        has_color = any(name.modality in LIT for name in outline.frames)
        exposures = dict(self._backend.exposures)
        return RenderedView(
            frames,
            samples if has_color else 0,
            json.dumps(exposures) if exposures else "",
        )


def _have_depth(cameras: Sequence[PlacedCamera]) -> bool:
    return any({DEPTH, RANGE}.intersection(camera.modalities) for camera in cameras)
