"""Colour images by Cycles: render settings, denoising, tone mapping."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from math import isclose
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import PyOpenColorIO
from numpy.typing import NDArray

from oaisys_core.backend.base import Device, RenderSettings, ViewTransform
from oaisys_core.backend.blender.background_geometry import CORES
from oaisys_core.backend.blender.compat import DIFFUSE_COLOR
from oaisys_core.backend.blender.denoiser import (
    CYCLES_WIDTH_PX,
    SAMPLED_WIDTH_PX,
    Denoiser,
    blenders_denoiser,
    filter_denoised,
    filter_guide,
)
from oaisys_core.backend.blender.devices import use_device
from oaisys_core.backend.blender.engine import RenderResult, render_scene
from oaisys_core.backend.blender.time_budget import DenoisingQuality
from oaisys_core.color import encoded
from oaisys_core.errors import RenderError

COMBINED = "Combined"
GUIDES = ("Denoising Albedo", "Denoising Normal")

BASE_EXPOSURE_EV = 0.6
"""Added to the configured exposure, so that 0 EV shows dry ground in full sun as mid-grey."""

VIEW_TRANSFORMS = {"agx": "AgX", "filmic": "Filmic", "standard": "Standard", "raw": "Raw"}
"""Blender's names of the view transforms; all of them give sRGB, except raw, which is linear."""


class Cycles:
    """Renders colour, and keeps Cycles' copy of the scene between views."""

    def __init__(self) -> None:
        self._wanted: Device | None = None
        self.device: Device = "cpu"
        scene = bpy.context.scene
        render = scene.render
        render.engine = "CYCLES"
        render.use_persistent_data = True
        render.use_compositing = render.use_sequencer = False
        render.threads_mode = "AUTO"
        cycles = scene.cycles
        cycles.use_adaptive_sampling = False
        # There is one lamp to sample.
        cycles.use_light_tree = False
        cycles.debug_use_spatial_splits = True
        # The automatic pattern depends on the number of samples of an earlier render.
        cycles.sampling_pattern = "TABULATED_SOBOL"
        cycles.sample_clamp_indirect = 10.0
        cycles.caustics_reflective = cycles.caustics_refractive = False
        # Only used on GPUs, which denoise faster themselves.
        cycles.denoiser = "OPENIMAGEDENOISE"
        cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
        cycles.denoising_prefilter = cycles.denoising_quality = "FAST"

    def free_persistent_data(self) -> None:
        """Free what Cycles keeps between views, which includes parts of removed worlds."""
        render = bpy.context.scene.render
        render.use_persistent_data = False
        render.use_persistent_data = True

    def render_radiance(self, settings: RenderSettings, seconds: float = 0.0) -> RenderResult:
        """Render the radiance that the scene's camera sees.

        Args:
            settings: Quality, exposure and seed.
            seconds: Time limit of sampling, after at least one sample per pixel; 0: none.

        Raises:
            RenderError: Blender failed.
        """
        self._show_as(settings)
        return self._render(settings, seconds, denoise=settings.denoise)

    def denoise_and_tonemap(
        self, rendered: RenderResult, settings: RenderSettings, denoising: DenoisingQuality
    ) -> NDArray[np.uint8]:
        """Return the (H, W, 3) sRGB image of what `render_radiance` gave with the same settings.

        Raises:
            RenderError: The passes are missing, or denoising failed.
        """
        radiance = _pass(rendered, COMBINED)
        if settings.denoise:
            if denoiser := self._denoiser():
                radiance = denoiser.denoise(radiance, *_guides(rendered, denoising), denoising)
            radiance = filter_denoised(radiance[..., :3], rendered.samples or settings.samples)
        return to_pixels(radiance, settings.view_transform, _exposure_ev(settings))

    def render_albedo(self, settings: RenderSettings, seconds: float = 0.0) -> NDArray[np.uint8]:
        """Return the (H, W, 3) sRGB-encoded albedo that the scene's camera sees.

        Raises:
            RenderError: See `render_radiance`.
        """
        layer = bpy.context.view_layer
        layer.use_pass_diffuse_color = True
        try:
            rendered = self._render(settings, seconds, denoise=False)
        finally:
            layer.use_pass_diffuse_color = False
        return encoded(np.ascontiguousarray(_pass(rendered, DIFFUSE_COLOR)))

    def _show_as(self, settings: RenderSettings) -> None:
        """Set Blender's view transform, so that a saved scene looks like the images."""
        exposure_ev = _exposure_ev(settings)
        view = bpy.context.scene.view_settings
        view_transform = VIEW_TRANSFORMS[settings.view_transform]
        if view.view_transform != view_transform:
            view.view_transform = view_transform
        if not isclose(view.exposure, exposure_ev, abs_tol=1e-6):
            view.exposure = exposure_ev

    def _render(self, settings: RenderSettings, seconds: float, denoise: bool) -> RenderResult:
        if settings.device != self._wanted:
            self._wanted, self.device = settings.device, use_device(settings.device)
        denoise_after = denoise and self._denoiser() is not None
        layer = bpy.context.view_layer.cycles
        # Assigning even the same value marks the whole scene as changed.
        if layer.denoising_store_passes != denoise_after:
            layer.denoising_store_passes = denoise_after
        wanted: dict[str, Any] = {
            "samples": settings.samples,
            "time_limit": seconds,
            "seed": settings.seed,
            "use_denoising": denoise and not denoise_after,
            # The same for albedo and colour, because a change marks the whole scene as changed.
            "filter_width": SAMPLED_WIDTH_PX if settings.denoise else CYCLES_WIDTH_PX,
        }
        for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
            wanted[f"{kind}_bounces"] = settings.max_bounces
        try:
            return render_scene(wanted)
        except RuntimeError as error:
            raise RenderError(f"Blender could not render: {error}") from error

    def _denoiser(self) -> Denoiser | None:
        """Return the denoiser that runs after Cycles; None on a GPU, where Cycles denoises."""
        return blenders_denoiser() if self.device == "cpu" else None


def _exposure_ev(settings: RenderSettings) -> float:
    return BASE_EXPOSURE_EV + settings.exposure_ev


def _guides(
    rendered: RenderResult, denoising: DenoisingQuality
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the albedo and normals that guide the denoiser; it filters them if thorough."""
    albedo, normal = (_pass(rendered, name) for name in GUIDES)
    if denoising == "thorough":
        return albedo, normal
    return filter_guide(albedo), filter_guide(normal)


def _pass(rendered: RenderResult, name: str) -> NDArray[np.float32]:
    if name not in rendered.passes:
        raise RenderError(f"Blender rendered no pass {name}, only {sorted(rendered.passes)}")
    return rendered.passes[name]


def to_pixels(
    radiance: NDArray[np.float32], view_transform: ViewTransform, exposure_ev: float
) -> NDArray[np.uint8]:
    """Return the (H, W, 3) image that Blender would write of (H, W, 3 or 4) radiance."""
    image = np.ascontiguousarray(radiance[..., :3])
    if exposure_ev:
        image = image * np.float32(2.0**exposure_ev)
    processor = _processor(view_transform)
    # OpenColorIO itself uses one thread per call.
    with ThreadPoolExecutor(CORES) as pool:
        list(pool.map(processor.applyRGB, np.array_split(image, CORES)))
    np.clip(image, 0.0, 1.0, out=image)
    # Rounds as Blender does.
    return np.asarray(image * np.float32(255) + np.float32(0.5), dtype=np.uint8)


@cache
def _processor(view_transform: ViewTransform) -> Any:
    """Return OpenColorIO's processor of one of Blender's view transforms."""
    folder = bpy.utils.system_resource("DATAFILES", path="colormanagement")
    config = PyOpenColorIO.Config.CreateFromFile(str(Path(folder) / "config.ocio"))
    transform = PyOpenColorIO.DisplayViewTransform(
        src=PyOpenColorIO.ROLE_SCENE_LINEAR,
        display=config.getDefaultDisplay(),
        view=VIEW_TRANSFORMS[view_transform],
    )
    return config.getProcessor(transform).getDefaultCPUProcessor()
