"""The backend without Blender: exact depth and labels in milliseconds, and simply shaded colour."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

import oaisys_core
from oaisys_core.color import encode_srgb
from oaisys_core.errors import NotReadyError
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.base import Backend, FrameGroup
from oaisys_core.render.color_frames import ColorFrames, color_frames
from oaisys_core.render.draft.draft import DraftRenderer
from oaisys_core.render.draft.frames import DRAFT, develop, draft_frames
from oaisys_core.render.geometry_pass import PoseMemory, frames_of
from oaisys_core.render.lidar import LidarCaster
from oaisys_core.render.shading.shading import Palette, shade
from oaisys_core.scene import PlacedCamera, PlacedLidar, Scene, stands_on
from oaisys_core.sensing.exposure import meter_ev
from oaisys_core.sensing.faults import CaptureId
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.sensing.view_transforms import ExposedImage
from oaisys_core.types import (
    ALBEDO,
    LIT,
    RENDERED,
    FloatArray,
    Frame,
    LidarScan,
    Progress,
    ProgressCallback,
    TriangleMesh,
)


class AnalyticBackend(Backend):
    """Casts rays at the scene itself: closed forms where there are some, else its triangles.

    Colour has no shadows: Lambert's law under sun, sky and lamps, with the images of meshes from
    files and the mean colour of all other textures. Quality, samples and bounces do not matter to
    it; exposure does.
    """

    name = "analytic"

    def __init__(self) -> None:
        self._surface: Surface | None = None
        self._palette: Palette | None = None
        self._draft = DraftRenderer()
        self._memory = PoseMemory()
        self._lidars = LidarCaster()
        self.exposures: dict[str, float] = {}

    @property
    def version(self) -> str:
        """The package's version."""
        return oaisys_core.__version__

    def build(self, scene: Scene, progress: ProgressCallback) -> None:
        """Replace the world by ``scene``."""
        surface = self._surface
        self.close()
        progress(Progress("ground", 0.0))
        if surface is not None and stands_on(surface.scene, scene):
            surface.start_batch(scene)
        else:
            surface = Surface(scene, None)
        progress(Progress("colours", 0.9))
        self._palette = Palette(scene)
        self._surface = surface

    def update(self, scene: Scene) -> None:
        """See `Backend.update`."""
        surface, palette = self._require_built()
        if scene.ground is surface.scene.ground:
            surface.update_objects(scene)
        else:
            surface.update(scene, None)
        palette.update(scene)

    def render(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
    ) -> Iterator[FrameGroup]:
        """See `Backend.render`."""
        surface, _ = self._require_built()
        self.exposures = {}
        with surface.in_parallel():
            yield from self._groups(cameras, settings, progress)
        self._memory.remember(cameras, surface.scene)

    def scan(self, lidar: PlacedLidar, capture: CaptureId) -> LidarScan:
        """See `Backend.scan`."""
        return self._lidars.scan(self._require_built()[0], lidar, capture)

    def note_revisit(self, cameras: Sequence[PlacedCamera]) -> None:
        """See `Backend.note_revisit`."""
        self._memory.remember(cameras, self._require_built()[0].scene)

    def withdrawn(self) -> None:
        """See `Backend.withdrawn`."""
        self._memory.withdraw()

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return ground, objects and tessellated solids with ids per triangle."""
        return self._require_built()[0].mesh()

    def surface_height_m(self, xy_m: FloatArray) -> FloatArray:
        """See `Backend.surface_height_m`."""
        return self._require_built()[0].height_m(xy_m)

    def close(self) -> None:
        """Drop the world."""
        self._surface = self._palette = None
        self._memory.forget()
        self._lidars.forget()

    def _groups(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
    ) -> Iterator[FrameGroup]:
        """Yield the geometry of all cameras, then the colours of each."""
        surface, palette = self._require_built()
        geometry: list[Frame] = []
        views: dict[str, View] = {}
        for index, camera in enumerate(cameras):
            progress(Progress("rays", 0.5 * index / len(cameras)))
            view = surface.view(camera)
            geometry.extend(frames_of(surface, view, camera, self._memory).values())
            if RENDERED.intersection(camera.modalities):
                views[camera.name] = view
        if geometry:
            yield FrameGroup.of(geometry)
        for index, camera in enumerate(cameras):
            progress(Progress("color", 0.5 + 0.5 * index / len(cameras)))
            if camera.name not in views:
                continue
            view = views.pop(camera.name)
            if settings.quality == DRAFT:
                found = draft_frames(self._draft, surface, view, camera, settings, develop)
            else:
                found = _colors(surface, palette, view, camera, settings)
            self.exposures |= found.exposures
            yield FrameGroup.of(found.frames)

    def _require_built(self) -> tuple[Surface, Palette]:
        if self._surface is None or self._palette is None:
            raise NotReadyError("the analytic backend has no scene: build one first")
        return self._surface, self._palette


def _colors(
    surface: Surface,
    palette: Palette,
    view: View,
    camera: PlacedCamera,
    settings: RenderSettings,
) -> ColorFrames:
    """Return the frames of a view that show colours."""
    is_lit = not LIT.isdisjoint(camera.modalities)
    radiance = shade(view, palette, surface) if is_lit else np.empty(0)
    albedo = palette.albedo(view, surface) if ALBEDO in camera.modalities else np.empty(0)
    seen = radiance, albedo, view.is_hit
    return color_frames(*seen, camera, surface.scene, settings, _develop)


def _develop(
    radiance: FloatArray, is_surface: NDArray[np.bool_], settings: RenderSettings
) -> ExposedImage:
    """Return the picture of (H, W, 3) radiance: exposed and encoded, without a view transform."""
    metered, exposure_ev = radiance.astype(np.float32), settings.exposure_ev
    if exposure_ev is None:
        exposure_ev = meter_ev(metered, is_surface, settings.auto_exposure)
    return ExposedImage(encode_srgb(radiance * 2.0**exposure_ev), exposure_ev, metered)
