"""The backend that renders with Blender's Cycles."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial
from math import inf
from pathlib import Path

import bpy

from oaisys_core.errors import NotReadyError
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.base import Backend, FrameGroup
from oaisys_core.render.blender.adaptive_samples import adapt
from oaisys_core.render.blender.color import ColorImages, ColorRenderer
from oaisys_core.render.blender.cycles import Cycles
from oaisys_core.render.blender.materials.ground.albedo import PixelAlbedo
from oaisys_core.render.blender.materials.ground.lens_blur import albedo_behind
from oaisys_core.render.blender.objects.lamps import LampObjects
from oaisys_core.render.blender.objects.scene_geometry import SceneGeometry
from oaisys_core.render.blender.objects.sky import Lights
from oaisys_core.render.blender.precision import check_precision
from oaisys_core.render.blender.tone_mapping import picture_of
from oaisys_core.render.draft.draft import DraftRenderer
from oaisys_core.render.draft.frames import DRAFT, draft_frames
from oaisys_core.render.geometry_pass import (
    BackgroundGeometry,
    PoseMemory,
    frame_of,
    frames_of,
)
from oaisys_core.render.lidar import LidarCaster
from oaisys_core.render.shading.looks import TEXEL_PX, pixel_angle_rad
from oaisys_core.scene import PlacedCamera, PlacedLidar, Scene
from oaisys_core.sensing.faults import CaptureId
from oaisys_core.sensing.render_settings import RenderSettings
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
    ignore_progress,
)

NOISY_SAMPLES = 2, 4
"""Least and most samples per pixel at which `GroundAlbedo` improves the picture.

With fewer samples, the noise of the light hides the gain. With more, the albedo that Cycles renders
has less noise than `GroundAlbedo` has errors.
"""


class BlenderBackend(Backend):
    """Photorealistic colour from Cycles; depth and labels from rays cast at the same triangles.

    Blender holds one scene per process: there may be one such backend in a process at a time,
    used from the main thread. Depth and labels are cast at the ground as it is read back from
    Blender, and at the very meshes and poses that Blender was given, without any mixing of
    pixels; spheres and boxes are cast in closed form, and their colour is rendered from a
    tessellation.
    """

    name = "blender"

    def __init__(self) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._cycles = Cycles()
        self._scene_geometry = SceneGeometry()
        self._lights = Lights()
        self._lamps = LampObjects()
        self._colors = ColorRenderer(self._cycles, self._lights)
        self._draft = DraftRenderer(self._scene_geometry.images)
        self._is_draft = False
        self._surface: Surface | None = None
        self._memory = PoseMemory()
        self._lidars = LidarCaster()
        self.exposures: dict[str, float] = {}

    @property
    def device(self) -> str:  # type: ignore[override]
        """What colour was rendered on."""
        return "cpu" if self._is_draft else self._cycles.device

    @property
    def version(self) -> str:
        """Blender's version, such as ``5.2.3``."""
        return ".".join(str(part) for part in bpy.app.version)

    def build(self, scene: Scene, progress: ProgressCallback) -> None:
        """Replace the world by ``scene``; a ground of the same hash and material stays."""
        surface, self._surface = self._surface, None
        self._colors.world_changed()
        progress(Progress("clear", 0.0))
        self._cycles.free_persistent_data()
        if not self._scene_geometry.clear(scene):
            surface = None
        progress(Progress("ground", 0.05))
        self._scene_geometry.build_ground(scene)
        progress(Progress("objects", 0.5))
        self._scene_geometry.build_objects(scene)
        self._set_light(scene)
        progress(Progress("surface", 0.7))
        self._memory.forget()
        self._lidars.forget()
        if surface is None:
            surface = Surface(scene, self._scene_geometry.ground_mesh())
        else:
            surface.start_batch(scene)
        self._surface = surface

    def update(self, scene: Scene) -> None:
        """See `Backend.update`."""
        surface = self._require_built()
        is_new_ground = self._scene_geometry.update(scene)
        self._set_light(scene)
        if is_new_ground:
            self._colors.world_changed()
            surface.update(scene, self._scene_geometry.ground_mesh())
        else:
            surface.update_objects(scene)

    def render(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
    ) -> Iterator[FrameGroup]:
        """See `Backend.render`."""
        surface = self._require_built()
        self.samples_per_pixel = None
        self.exposures = {}
        for camera in cameras:
            if RENDERED.intersection(camera.modalities) and settings.quality != DRAFT:
                check_precision(surface, camera)
        self._is_draft = settings.quality == DRAFT
        if self._is_draft or not any(RENDERED.intersection(each.modalities) for each in cameras):
            with surface.in_parallel():
                yield from self._drafts(cameras, settings, progress)
        else:
            yield from self._with_colors(cameras, settings, progress)
        self._memory.remember(cameras, surface.scene)

    def scan(self, lidar: PlacedLidar, capture: CaptureId) -> LidarScan:
        """See `Backend.scan`."""
        return self._lidars.scan(self._require_built(), lidar, capture)

    def note_revisit(self, cameras: Sequence[PlacedCamera]) -> None:
        """See `Backend.note_revisit`."""
        self._memory.remember(cameras, self._require_built().scene)

    def withdrawn(self) -> None:
        """See `Backend.withdrawn`."""
        self._memory.withdraw()

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return ground, objects and tessellated solids with ids per triangle."""
        return self._require_built().mesh()

    def surface_height_m(self, xy_m: FloatArray) -> FloatArray:
        """See `Backend.surface_height_m`."""
        return self._require_built().height_m(xy_m)

    def save(self, path: Path) -> None:
        """Write Blender's scene, its images packed into the file."""
        self._require_built()
        self._cycles.show_last_exposure()
        bpy.ops.file.pack_all()
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=True)

    def close(self) -> None:
        """Empty Blender."""
        self._surface = None
        bpy.ops.wm.read_factory_settings(use_empty=True)

    def _with_colors(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
    ) -> Iterator[FrameGroup]:
        """Render colours on this thread while another one computes the geometry."""
        self._scene_geometry.images.begin_render()
        ends_s = time.perf_counter() + (settings.time_budget_s or inf)
        colors = [each for camera in cameras for each in self._color_renders(camera, settings)]
        scene = self._require_built().scene
        views: dict[str, View] = {}
        with BackgroundGeometry(partial(self._geometry, cameras, views=views)) as geometry:
            ground = {
                camera.name: geometry.then(partial(self._ground_albedo, camera, chosen, views))
                for camera, modalities, chosen in colors
                if LIT.intersection(modalities) and self._has_use_of_albedo(camera, chosen)
            }
            check = self._colors.ground_check
            places = {
                camera.name: geometry.then(partial(check.places, self._require_built(), camera))
                for camera, _, _ in colors
            }
            if any(set(camera.modalities) - RENDERED for camera in cameras):
                yield geometry.group
            for index, (camera, modalities, chosen) in enumerate(colors):
                progress(Progress("color", index / len(colors)))
                left_s = (ends_s - time.perf_counter()) / (len(colors) - index)
                if LIT.intersection(modalities):
                    found = self._colors.color(
                        scene,
                        camera,
                        chosen,
                        left_s,
                        modalities=modalities,
                        geometry=None if index else geometry,
                        places=places[camera.name],
                        ground=ground.get(camera.name),
                    )
                    self._note(found)
                    images = found.images
                else:
                    seen = places[camera.name]
                    images = {ALBEDO: self._colors.albedo(scene, camera, chosen, left_s, seen)}
                geometry.group.result()
                yield FrameGroup.of([frame_of(camera, *each) for each in images.items()])
        self._scene_geometry.images.end_render()

    def _drafts(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
    ) -> Iterator[FrameGroup]:
        """Render the geometry, then colours, if there are any, without Cycles."""
        surface = self._require_built()
        views: dict[str, View] = {}
        if frames := self._geometry(cameras, progress, views):
            yield FrameGroup.of(frames)
        for index, camera in enumerate(cameras):
            if not RENDERED.intersection(camera.modalities):
                continue
            progress(Progress("color", index / len(cameras)))
            view = views.pop(camera.name, None) or surface.view(camera)
            found = draft_frames(self._draft, surface, view, camera, settings, picture_of)
            self.exposures |= found.exposures
            yield FrameGroup.of(found.frames)

    def _color_renders(
        self, camera: PlacedCamera, settings: RenderSettings
    ) -> list[tuple[PlacedCamera, tuple[str, ...], RenderSettings]]:
        """Return which of a camera's colour modalities come from which of its renders, and how.

        Albedo comes with colour where nothing blurs, veils or scales this, and time is not short.
        """
        lit = tuple(each for each in camera.modalities if each in LIT)
        albedo = tuple(each for each in camera.modalities if each == ALBEDO)
        if not lit + albedo:
            return []
        surface = self._require_built()
        # For albedo alone, too, so that it does not depend on what is rendered beside it.
        has_gloss = self._scene_geometry.ground_albedo.has_gloss
        chosen = adapt(surface, camera, settings, has_gloss=has_gloss)
        scene = surface.scene
        is_clear = camera.is_sharp and scene.sky.haze is None and scene.material.law is None
        if is_clear and settings.time_budget_s is None:
            return [(camera, lit + albedo, chosen)]
        return [(camera, each, chosen) for each in (lit, albedo) if each]

    def _geometry(
        self,
        cameras: Sequence[PlacedCamera],
        progress: ProgressCallback = ignore_progress,
        views: dict[str, View] | None = None,
    ) -> tuple[Frame, ...]:
        """Return all cameras' frames but their colours; nothing of Blender's is touched.

        What the cameras see is added to ``views``, by name, where it was needed.
        """
        surface = self._require_built()
        frames: list[Frame] = []
        for index, camera in enumerate(cameras):
            progress(Progress("geometry", index / len(cameras)))
            if set(camera.modalities) <= RENDERED:
                continue
            view = surface.view(camera)
            frames.extend(frames_of(surface, view, camera, self._memory).values())
            if views is not None:
                views[camera.name] = view
        return tuple(frames)

    def _has_use_of_albedo(self, camera: PlacedCamera, settings: RenderSettings) -> bool:
        """Return whether colour becomes better by the ground's albedo without noise."""
        is_direct = camera.intrinsics.is_rectilinear
        least, most = NOISY_SAMPLES
        is_noisy = settings.denoise and least <= settings.samples <= most
        return camera.is_still and is_direct and is_noisy and self.device == "cpu"

    def _ground_albedo(
        self, camera: PlacedCamera, settings: RenderSettings, views: dict[str, View]
    ) -> PixelAlbedo | None:
        """Return the ground's albedo without noise; nothing of Blender's is touched."""
        surface = self._require_built()
        view = views.get(camera.name) or surface.view(camera)
        pixel_rad = pixel_angle_rad(camera.intrinsics, TEXEL_PX)
        ground_albedo = self._scene_geometry.ground_albedo
        found = ground_albedo.of_view(view, pixel_rad, surface.scene.sky)
        if found is None or camera.lens is None:
            return found
        return albedo_behind(camera.lens, camera.intrinsics, view, found)

    def _note(self, found: ColorImages) -> None:
        """Remember how a camera's colour was rendered, and the fewest samples of all cameras."""
        self.exposures |= found.exposures
        samples = found.samples_per_pixel
        self.samples_per_pixel = min(samples, self.samples_per_pixel or samples)

    def _set_light(self, scene: Scene) -> None:
        is_new_sky = self._lights.set(scene.sky, scene.material.law)
        are_new_lamps = self._lamps.set(scene.lamps)
        if is_new_sky or are_new_lamps:
            self._colors.world_changed()
        self._scene_geometry.images.remove_unused()
        kinds = tuple(lamp.kind for lamp in scene.lamps)
        self._cycles.use_lamps(kinds, has_sun=scene.sky.lamp_w_m2 > 0)

    def _require_built(self) -> Surface:
        if self._surface is None:
            raise NotReadyError("Blender has no scene: build one first")
        return self._surface
