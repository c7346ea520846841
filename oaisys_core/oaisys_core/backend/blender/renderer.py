"""The backend that renders with Blender's Cycles."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from math import inf
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.backend.base import (
    Backend,
    FramesCallback,
    ProgressCallback,
    RenderSettings,
    ignore_frames,
    in_order,
)
from oaisys_core.backend.blender.budget import TimeBudget
from oaisys_core.backend.blender.camera import moving, new_camera, place, set_intrinsics, set_lens
from oaisys_core.backend.blender.cycles import Cycles
from oaisys_core.backend.blender.distortion import covering_pinhole, distorted_image
from oaisys_core.backend.blender.lights import Lights
from oaisys_core.backend.blender.world import World
from oaisys_core.backend.flow import PoseMemory
from oaisys_core.backend.passes import frame_of, geometry_frames
from oaisys_core.backend.surface import Surface
from oaisys_core.effects import with_effects
from oaisys_core.errors import NotReadyError
from oaisys_core.scene import PlacedCamera, Scene, Sky
from oaisys_core.types import (
    ALBEDO,
    RGB,
    FloatArray,
    Frame,
    PinholeIntrinsics,
    Progress,
    TriangleMesh,
)

GEOMETRY_SHARE = 0.1
"""Of a sample's progress, until its colours begin."""


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
        self._world = World()
        self._lights = Lights()
        self._camera = new_camera()
        self._surface: Surface | None = None
        self._memory = PoseMemory()
        self._budget = TimeBudget()

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
        progress(Progress("clear", 0.0))
        self._cycles.forget()
        if not self._world.clear(scene):
            surface = None
        progress(Progress("ground", 0.05))
        self._world.build_ground(scene)
        progress(Progress("objects", 0.5))
        self._world.build_objects(scene)
        self._set_sky(scene.sky)
        progress(Progress("surface", 0.7))
        self._memory.forget()
        if surface is None:
            surface = Surface(scene, self._world.ground_mesh())
        else:
            surface.begin_again(scene)
        self._surface = surface

    def update(self, scene: Scene) -> None:
        """See `Backend.update`."""
        surface = self._built()
        is_new_ground = self._world.update(scene)
        self._set_sky(scene.sky)
        if is_new_ground:
            surface.update(scene, self._world.ground_mesh())
        else:
            surface.update_objects(scene)

    def render(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
        on_frames: FramesCallback = ignore_frames,
    ) -> tuple[Frame, ...]:
        """See `Backend.render`."""
        surface = self._built()
        ends_s = time.perf_counter() + (settings.time_budget_s or inf)
        self.light_samples = None
        frames: list[Frame] = []
        for index, camera in enumerate(cameras):
            progress(Progress("geometry", GEOMETRY_SHARE * index / len(cameras)))
            frames.extend(geometry_frames(surface, camera, self._memory).values())
        if frames:
            on_frames(tuple(frames))
        for index, camera in enumerate(cameras):
            share = index / len(cameras)
            progress(Progress("color", GEOMETRY_SHARE + (1 - GEOMETRY_SHARE) * share))
            left_s = (ends_s - time.perf_counter()) / (len(cameras) - index)
            for modality in (RGB, ALBEDO):
                if modality not in camera.modalities:
                    continue
                if modality == RGB:
                    image = self._color(camera, settings, left_s)
                else:
                    image = self._albedo(camera, settings)
                frames.append(frame_of(camera, modality, image))
                on_frames((frames[-1],))
        self._memory.remember(cameras, surface.scene)
        return in_order(cameras, frames)

    def revisited(self, cameras: Sequence[PlacedCamera]) -> None:
        """See `Backend.revisited`."""
        self._memory.remember(cameras, self._built().scene)

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return ground, objects and tessellated solids with ids per triangle."""
        return self._built().mesh()

    def surface_height_m(self, xy_m: FloatArray) -> FloatArray:
        """See `Backend.surface_height_m`."""
        return self._built().height_m(xy_m)

    def save(self, path: Path) -> None:
        """Write Blender's scene, its images packed into the file."""
        self._built()
        bpy.ops.file.pack_all()
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=True)

    def close(self) -> None:
        """Empty Blender."""
        self._surface = None
        bpy.ops.wm.read_factory_settings(use_empty=True)

    def _color(
        self, camera: PlacedCamera, settings: RenderSettings, seconds: float
    ) -> NDArray[np.uint8]:
        """Return the colour image of a camera, in the seconds that are left for it."""
        samples = settings.samples
        pinhole = self._aim(camera)
        if settings.time_budget_s is not None:
            samples = self._budget.samples(pinhole, seconds, samples)
            self.light_samples = min(samples, self.light_samples or samples)
        set_lens(self._camera, camera.lens)
        started_s = time.perf_counter()
        with moving(self._camera, camera.T_map_previous, camera.shutter_share):
            image = self._cycles.render(replace(settings, samples=samples))
        self._budget.learn(pinhole, samples, time.perf_counter() - started_s)
        if pinhole is not camera.intrinsics:
            image = distorted_image(image, pinhole, camera.intrinsics)
        rng = randomness.stream(settings.noise_seed, camera.name)
        return with_effects(image, settings.effects, camera.intrinsics, rng)

    def _albedo(self, camera: PlacedCamera, settings: RenderSettings) -> NDArray[np.uint8]:
        """Return the reflectance that a camera sees, without depth of field or motion."""
        pinhole = self._aim(camera)
        samples = self.light_samples or settings.samples
        set_lens(self._camera, None)
        sky = self._built().scene.sky
        # Haze is part of the materials' colours.
        if sky.haze is not None:
            self._lights.set(replace(sky, haze=None))
        try:
            image = self._cycles.render_albedo(replace(settings, samples=samples))
        finally:
            if sky.haze is not None:
                self._lights.set(sky)
        if pinhole is camera.intrinsics:
            return image
        return distorted_image(image, pinhole, camera.intrinsics)

    def _aim(self, camera: PlacedCamera) -> PinholeIntrinsics:
        """Place Blender's camera and return its intrinsics: the camera's own, unless distorted."""
        pinhole = camera.intrinsics
        if any(pinhole.distortion):
            pinhole = covering_pinhole(pinhole)
        place(self._camera, camera.T_map_camera)
        set_intrinsics(self._camera, pinhole)
        return pinhole

    def _set_sky(self, sky: Sky) -> None:
        self._lights.set(sky)
        self._world.show_plain(sky.has_plain and sky.hdri is None)

    def _built(self) -> Surface:
        if self._surface is None:
            raise NotReadyError("Blender has no scene: build one first")
        return self._surface
