"""The colour modalities of a camera, rendered with Cycles."""

from __future__ import annotations

import time
from collections.abc import Collection
from concurrent.futures import Future
from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.errors import RenderError
from oaisys_core.procedural.environment.light import white_gains
from oaisys_core.render.blender.camera import (
    camera_image,
    moving,
    new_camera,
    pinhole_to_render,
    place,
    scale_pinhole,
    set_intrinsics,
    set_lens,
    shutter_motion,
)
from oaisys_core.render.blender.cycles import Cycles, albedo_of
from oaisys_core.render.blender.ground_check import GroundCheck, GroundPlaces
from oaisys_core.render.blender.materials.footprint import set_pixel_angle
from oaisys_core.render.blender.materials.ground.albedo import PixelAlbedo
from oaisys_core.render.blender.materials.ground.narrow_patches import Patches
from oaisys_core.render.blender.objects.sky import Lights
from oaisys_core.render.blender.time_budget import (
    DenoisingQuality,
    TimeBudget,
    ViewCost,
    denoising_quality_for,
    lowest_quality,
)
from oaisys_core.render.geometry_pass import BackgroundGeometry
from oaisys_core.render.light_images import light_images
from oaisys_core.render.render_result import RenderResult
from oaisys_core.scene import Lens, PlacedCamera, Scene
from oaisys_core.sensing.effects import with_effects
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import ALBEDO, LIT, RGB, PinholeIntrinsics


class ColorImages(NamedTuple):
    """What was rendered of a camera's colour.

    Attributes:
        images: (H, W) or (H, W, 3) images by modality.
        samples_per_pixel: How many samples colour has.
        exposures: See `Backend.exposures`.
    """

    images: dict[str, NDArray[np.generic]]
    samples_per_pixel: int
    exposures: dict[str, float]


class ColorRenderer:
    """Renders colour and albedo with Blender's camera, in the time that is left for them.

    It learns from each view how much another one like it takes.

    Attributes:
        ground_check: Checks each image.
    """

    def __init__(self, cycles: Cycles, lights: Lights) -> None:
        self._cycles = cycles
        self.ground_check = GroundCheck()
        self._lights = lights
        self._camera = new_camera()
        self._budget = TimeBudget()

    def world_changed(self) -> None:
        """Forget what the views of another world took."""
        self._budget.world_changed()

    def color(
        self,
        scene: Scene,
        camera: PlacedCamera,
        settings: RenderSettings,
        seconds: float,
        *,
        modalities: Collection[str],
        geometry: BackgroundGeometry | None,
        places: Future[GroundPlaces],
        ground: Future[PixelAlbedo | None] | None,
    ) -> ColorImages:
        """Return what a camera sees.

        Args:
            scene: The world that Blender has.
            camera: The camera.
            settings: How to render.
            seconds: How long it may take.
            modalities: What is wanted of it, all from the same render.
            geometry: What another thread computes meanwhile.
            places: Where the camera sees ground that reflects light.
            ground: The ground's albedo without noise, where colour becomes better by it.

        Raises:
            RenderError: See `Cycles.render_radiance`; or ground is black.
        """
        began_s = time.perf_counter()
        pinhole = pinhole_to_render(camera.intrinsics)
        plan = self._budget.plan(_pixels(pinhole), seconds)
        rendered = scale_pinhole(pinhole, plan.scale)
        self._aim(camera, rendered, camera.lens)
        started_s = time.perf_counter()
        with moving(self._camera, shutter_motion(camera, pinhole, rendered)):
            light = self._cycles.render_radiance(settings, plan.sampling_s)
        self._check(light, camera, places)
        denoising = denoising_quality_for(settings.samples)
        if settings.time_budget_s is not None:
            left_s = began_s + seconds - time.perf_counter()
            spare = self._budget.denoising_quality(
                _pixels(rendered), light.samples, left_s, seconds
            )
            denoising = lowest_quality(denoising, spare)
        # An image of fewer pixels, which a short time budget asks for, has no albedo of its own.
        albedo = ground.result() if ground is not None and rendered is pinhole else None
        is_balanced = settings.white_balance == "illuminant"
        gains = white_gains(scene.sky, scene.lamps) if is_balanced else None
        patches = _patches(scene, camera, rendered)
        picture = self._cycles.denoise_and_tonemap(
            light, settings, denoising, albedo, gains, patches
        )
        self._learn(rendered, light, started_s, denoising, geometry)
        images: dict[str, NDArray[np.generic]] = {}
        if RGB in modalities:
            image = camera_image(picture.pixels, pinhole, camera.intrinsics)
            rng = randomness.stream(settings.noise_seed, camera.name)
            images[RGB] = with_effects(image, settings.effects, camera.intrinsics, rng)
        exposures = {camera.name: picture.exposure_ev} if RGB in modalities else {}
        if LIT.intersection(modalities) - {RGB}:
            seen = camera_image(picture.radiance, pinhole, camera.intrinsics)
            physical = light_images(seen, camera, scene.sky, settings.noise_seed)
            images |= physical.images
            exposures |= physical.exposures
        if ALBEDO in modalities:
            images[ALBEDO] = camera_image(albedo_of(light), pinhole, camera.intrinsics)
        return ColorImages(images, light.samples_per_pixel(settings), exposures)

    def albedo(
        self,
        scene: Scene,
        camera: PlacedCamera,
        settings: RenderSettings,
        seconds: float,
        places: Future[GroundPlaces],
    ) -> NDArray[np.uint8]:
        """Return the reflectance that a camera sees, without depth of field or motion blur.

        See `color`.
        """
        pinhole = pinhole_to_render(camera.intrinsics)
        plan = self._budget.plan(_pixels(pinhole), seconds)
        self._aim(camera, pinhole, None)
        # Haze and the factor of a photometric law are part of the materials' colours.
        is_plain = scene.sky.haze is None and scene.material.law is None
        if not is_plain:
            self._lights.set(replace(scene.sky, haze=None), None)
        sharp = replace(camera, shutter_share=0.0, exposure_s=0.0)
        try:
            with moving(self._camera, shutter_motion(sharp, pinhole, pinhole)):
                found = self._cycles.render_albedo(settings, plan.sampling_s)
        finally:
            if not is_plain:
                self._lights.set(scene.sky, scene.material.law)
        self._check(found, camera, places)
        return camera_image(albedo_of(found), pinhole, camera.intrinsics)

    def _check(
        self, found: RenderResult, camera: PlacedCamera, places: Future[GroundPlaces]
    ) -> None:
        """Raise if ground is black; Cycles starts anew then."""
        try:
            self.ground_check.check(places.result(), found, camera.name)
        except RenderError:
            self._cycles.free_persistent_data()
            raise

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


def _patches(scene: Scene, camera: PlacedCamera, pinhole: PinholeIntrinsics) -> Patches | None:
    """Return the ground's patches as sharp pictures have them; None for others, and one patch."""
    width_m = scene.material.patch_m
    if not (camera.is_sharp and isfinite(width_m)):
        return None
    return Patches(width_m, 1 / max(pinhole.fx_px, pinhole.fy_px))


def _pixels(pinhole: PinholeIntrinsics) -> int:
    return pinhole.width_px * pinhole.height_px
