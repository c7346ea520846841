"""The backend that renders with Blender's Cycles."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.backend.base import Backend, FrameGroup, ProgressCallback, RenderSettings
from oaisys_core.backend.blender.adaptive_samples import adapted
from oaisys_core.backend.blender.camera import (
    camera_image,
    moving,
    new_camera,
    pixel_angle_rad,
    place,
    rendered_pinhole,
    scaled_pinhole,
    set_intrinsics,
    set_lens,
    set_pixel_angle,
    shutter_motion,
)
from oaisys_core.backend.blender.cycles import Cycles, albedo_of
from oaisys_core.backend.blender.materials.ground_albedo import PixelAlbedo
from oaisys_core.backend.blender.objects.lamps import LampObjects
from oaisys_core.backend.blender.objects.scene_geometry import SceneGeometry
from oaisys_core.backend.blender.objects.sky import Lights
from oaisys_core.backend.blender.postprocessing import RenderResult
from oaisys_core.backend.blender.time_budget import (
    DenoisingQuality,
    TimeBudget,
    ViewCost,
    denoising_quality_for,
    lowest_quality,
)
from oaisys_core.backend.geometry_pass import (
    BackgroundGeometry,
    PoseMemory,
    frame_of,
    frames_of,
)
from oaisys_core.backend.lidar import LidarCaster
from oaisys_core.backend.surface import Surface, View
from oaisys_core.environment.light import white_gains
from oaisys_core.errors import NotReadyError
from oaisys_core.scene import Lens, PlacedCamera, PlacedLidar, Scene
from oaisys_core.sensing.effects import with_effects
from oaisys_core.sensing.faults import Shot
from oaisys_core.types import (
    ALBEDO,
    RGB,
    FloatArray,
    Frame,
    LidarScan,
    PinholeIntrinsics,
    Progress,
    TriangleMesh,
    ignore_progress,
)

NOISY_SAMPLES = 2, 4
"""From how many to how many samples per pixel `GroundAlbedo` is worth its time.

Fewer leave so much noise in light that it gains little; more have less noise in their own albedo
than it has errors.
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
        self._camera = new_camera()
        self._surface: Surface | None = None
        self._memory = PoseMemory()
        self._lidars = LidarCaster()
        self._budget = TimeBudget()
        self.exposures_ev: dict[str, float] = {}

    @property
    def device(self) -> str:  # type: ignore[override]
        """What Cycles renders on."""
        return self._cycles.device

    @property
    def version(self) -> str:
        """Blender's version, such as ``5.2.3``."""
        return ".".join(str(part) for part in bpy.app.version)

    def build(self, scene: Scene, progress: ProgressCallback) -> None:
        """Replace the world by ``scene``; a ground of the same hash and material stays."""
        surface, self._surface = self._surface, None
        self._budget.world_changed()
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
        surface = self._built()
        is_new_ground = self._scene_geometry.update(scene)
        self._set_light(scene)
        if is_new_ground:
            self._budget.world_changed()
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
        surface = self._built()
        self.samples_per_pixel = None
        self.exposures_ev = {}
        if any(m in camera.modalities for camera in cameras for m in (RGB, ALBEDO)):
            yield from self._with_colors(cameras, settings, progress)
        elif frames := self._geometry(cameras, progress):
            yield FrameGroup.of(frames)
        self._memory.remember(cameras, surface.scene)

    def scan(self, lidar: PlacedLidar, shot: Shot) -> LidarScan:
        """See `Backend.scan`."""
        return self._lidars.scan(self._built(), lidar, shot)

    def revisited(self, cameras: Sequence[PlacedCamera]) -> None:
        """See `Backend.revisited`."""
        self._memory.remember(cameras, self._built().scene)

    def withdrawn(self) -> None:
        """See `Backend.withdrawn`."""
        self._memory.withdraw()

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return ground, objects and tessellated solids with ids per triangle."""
        return self._built().mesh()

    def surface_height_m(self, xy_m: FloatArray) -> FloatArray:
        """See `Backend.surface_height_m`."""
        return self._built().height_m(xy_m)

    def save(self, path: Path) -> None:
        """Write Blender's scene, its images packed into the file."""
        self._built()
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
        ends_s = time.perf_counter() + (settings.time_budget_s or inf)
        colors = [each for camera in cameras for each in self._color_renders(camera, settings)]
        views: dict[str, View] = {}
        with BackgroundGeometry(partial(self._geometry, cameras, views=views)) as geometry:
            ground = {
                camera.name: geometry.then(partial(self._ground_albedo, camera, views))
                for camera, modalities, chosen in colors
                if RGB in modalities and self._has_use_of_albedo(camera, chosen)
            }
            if any(set(camera.modalities) - {RGB, ALBEDO} for camera in cameras):
                yield geometry.group
            for index, (camera, modalities, chosen) in enumerate(colors):
                progress(Progress("color", index / len(colors)))
                left_s = (ends_s - time.perf_counter()) / (len(colors) - index)
                if RGB in modalities:
                    beside = None if index else geometry
                    images = self._color(
                        camera, modalities, chosen, left_s, beside, ground.get(camera.name)
                    )
                else:
                    images = [self._albedo(camera, chosen, left_s)]
                geometry.group.result()
                yield FrameGroup.of(
                    [frame_of(camera, *each) for each in zip(modalities, images, strict=True)]
                )

    def _color_renders(
        self, camera: PlacedCamera, settings: RenderSettings
    ) -> list[tuple[PlacedCamera, tuple[str, ...], RenderSettings]]:
        """Return which of a camera's colour modalities come from which of its renders, and how.

        Albedo comes with colour where nothing blurs this or veils it, and time is not short.
        """
        wanted = tuple(each for each in (RGB, ALBEDO) if each in camera.modalities)
        if not wanted:
            return []
        surface = self._built()
        # For albedo alone, too, so that it does not depend on what is rendered beside it.
        chosen = adapted(surface, camera, settings)
        is_clear = _is_sharp(camera) and surface.scene.sky.haze is None
        if is_clear and settings.time_budget_s is None:
            return [(camera, wanted, chosen)]
        return [(camera, (each,), chosen) for each in wanted]

    def _geometry(
        self,
        cameras: Sequence[PlacedCamera],
        progress: ProgressCallback = ignore_progress,
        views: dict[str, View] | None = None,
    ) -> tuple[Frame, ...]:
        """Return all cameras' frames but their colours; nothing of Blender's is touched.

        What the cameras see is added to ``views``, by name, where it was needed.
        """
        surface = self._built()
        frames: list[Frame] = []
        for index, camera in enumerate(cameras):
            progress(Progress("geometry", index / len(cameras)))
            if set(camera.modalities) <= {RGB, ALBEDO}:
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
        return _is_sharp(camera) and is_direct and is_noisy and self.device == "cpu"

    def _ground_albedo(self, camera: PlacedCamera, views: dict[str, View]) -> PixelAlbedo | None:
        """Return the ground's albedo without noise; nothing of Blender's is touched."""
        surface = self._built()
        view = views.get(camera.name) or surface.view(camera)
        pixel_rad = pixel_angle_rad(camera.intrinsics)
        ground_albedo = self._scene_geometry.ground_albedo
        return ground_albedo.of_view(view, pixel_rad, surface.scene.sky)

    def _color(
        self,
        camera: PlacedCamera,
        modalities: tuple[str, ...],
        settings: RenderSettings,
        seconds: float,
        geometry: BackgroundGeometry | None,
        ground: Future[PixelAlbedo | None] | None,
    ) -> list[NDArray[np.uint8]]:
        """Return the colour image of a camera, in the seconds that are left for it.

        Its albedo follows if that is one of the ``modalities``. ``geometry`` is what another thread
        computes meanwhile, and ``ground`` the ground's albedo.
        """
        began_s = time.perf_counter()
        pinhole = rendered_pinhole(camera.intrinsics)
        plan = self._budget.plan(_pixels(pinhole), seconds)
        rendered = scaled_pinhole(pinhole, plan.scale)
        self._aim(camera, rendered, camera.lens)
        started_s = time.perf_counter()
        with moving(self._camera, shutter_motion(camera, pinhole, rendered)):
            light = self._cycles.render_radiance(
                settings, plan.sampling_s, with_albedo=ALBEDO in modalities
            )
        denoising = denoising_quality_for(settings.samples)
        samples = settings.samples if settings.time_budget_s is None else light.samples
        self.samples_per_pixel = min(samples, self.samples_per_pixel or samples)
        if settings.time_budget_s is not None:
            left_s = began_s + seconds - time.perf_counter()
            spare = self._budget.denoising_quality(
                _pixels(rendered), light.samples, left_s, seconds
            )
            denoising = lowest_quality(denoising, spare)
        # An image of fewer pixels, which a short time budget asks for, has no albedo of its own.
        albedo = ground.result() if ground is not None and rendered is pinhole else None
        gains = None
        if settings.white_balance == "illuminant":
            scene = self._built().scene
            gains = white_gains(scene.sky, scene.lamps)
        picture = self._cycles.denoise_and_tonemap(light, settings, denoising, albedo, gains)
        self.exposures_ev[camera.name] = picture.exposure_ev
        self._learn(rendered, light, started_s, denoising, geometry)
        image = camera_image(picture.pixels, pinhole, camera.intrinsics)
        rng = randomness.stream(settings.noise_seed, camera.name)
        images = [with_effects(image, settings.effects, camera.intrinsics, rng)]
        if ALBEDO in modalities:
            images.append(camera_image(albedo_of(light), pinhole, camera.intrinsics))
        return images

    def _albedo(
        self, camera: PlacedCamera, settings: RenderSettings, seconds: float
    ) -> NDArray[np.uint8]:
        """Return the reflectance that a camera sees, without depth of field or motion blur."""
        pinhole = rendered_pinhole(camera.intrinsics)
        plan = self._budget.plan(_pixels(pinhole), seconds)
        self._aim(camera, pinhole, None)
        sky = self._built().scene.sky
        # Haze is part of the materials' colours.
        if sky.haze is not None:
            self._lights.set(replace(sky, haze=None))
        try:
            with moving(self._camera, shutter_motion(_sharp(camera), pinhole, pinhole)):
                image = self._cycles.render_albedo(settings, plan.sampling_s)
        finally:
            if sky.haze is not None:
                self._lights.set(sky)
        return camera_image(image, pinhole, camera.intrinsics)

    def _aim(self, camera: PlacedCamera, pinhole: PinholeIntrinsics, lens: Lens | None) -> None:
        """Make Blender's camera one with such a lens, where ``camera`` stands."""
        place(self._camera, camera.T_map_camera)
        set_intrinsics(self._camera, pinhole)
        set_lens(self._camera, lens)
        # Not the pinhole's: where time is short, nothing is spent on other levels of textures.
        set_pixel_angle(camera.intrinsics)

    def _learn(
        self,
        pinhole: PinholeIntrinsics,
        light: RenderResult,
        started_s: float,
        denoising: DenoisingQuality,
        geometry: BackgroundGeometry | None,
    ) -> None:
        """Remember what the last view took since it was started."""
        if light.samples:
            sampling_s = light.sampling_ended_s - light.sampling_began_s
            self._budget.learn(
                ViewCost(
                    pixels=_pixels(pinhole),
                    samples=light.samples,
                    preparing_s=light.sampling_began_s - started_s,
                    sampling_s=sampling_s,
                    finishing_s=time.perf_counter() - light.sampling_ended_s,
                    denoising=denoising,
                    beside_s=geometry.cost_s(sampling_s) if geometry is not None else 0.0,
                )
            )

    def _set_light(self, scene: Scene) -> None:
        is_new_sky, are_new_lamps = self._lights.set(scene.sky), self._lamps.set(scene.lamps)
        if is_new_sky or are_new_lamps:
            self._budget.world_changed()
        kinds = tuple(lamp.kind for lamp in scene.lamps)
        self._cycles.use_lamps(kinds, has_sun=scene.sky.lamp_w_m2 > 0)

    def _built(self) -> Surface:
        if self._surface is None:
            raise NotReadyError("Blender has no scene: build one first")
        return self._surface


def _is_sharp(camera: PlacedCamera) -> bool:
    """Return whether a camera has neither depth of field nor motion blur."""
    return camera.lens is None and not (camera.shutter_share or camera.exposure_s)


def _sharp(camera: PlacedCamera) -> PlacedCamera:
    """Return the camera without motion blur."""
    return replace(camera, shutter_share=0.0, exposure_s=0.0)


def _pixels(pinhole: PinholeIntrinsics) -> int:
    return pinhole.width_px * pinhole.height_px
