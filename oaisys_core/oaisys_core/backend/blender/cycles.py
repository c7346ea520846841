"""Cycles: how colour is rendered, and the pixels."""

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
"""Exposure at a setting of 0: dry ground in full sun comes out in the middle of the range."""


class Cycles:
    """Renders colour, keeping the scene between views.

    Colours go through one of Blender's view transforms; AgX rolls bright parts off as film does.
    """

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
        # To choose between a sun and nothing else takes no tree.
        cycles.use_light_tree = False
        # A tenth less per ray, and no longer to build.
        cycles.debug_use_spatial_splits = True
        # Automatic patterns keep the length of an earlier render: pictures would depend on it.
        cycles.sampling_pattern = "TABULATED_SOBOL"
        cycles.sample_clamp_indirect = 10.0
        cycles.caustics_reflective = cycles.caustics_refractive = False
        # For GPUs, which denoise faster themselves.
        cycles.denoiser = "OPENIMAGEDENOISE"
        cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
        cycles.denoising_prefilter = cycles.denoising_quality = "FAST"

    def free_persistent_data(self) -> None:
        """Free what is kept between views: some of a world that went would stay there forever."""
        render = bpy.context.scene.render
        render.use_persistent_data = False
        render.use_persistent_data = True

    def render_light(self, settings: RenderSettings, seconds: float = 0.0) -> RenderResult:
        """Return the light that the scene's camera sees.

        Args:
            settings: Quality, exposure and seed.
            seconds: Light samples are taken for that long, but one at least; 0: all of them.

        Raises:
            RenderError: Blender failed.
        """
        self._show_as(settings)
        return self._render(settings, seconds, denoise=settings.denoise)

    def denoise_and_tonemap(
        self, rendered: RenderResult, settings: RenderSettings, denoising: DenoisingQuality
    ) -> NDArray[np.uint8]:
        """Return the (H, W, 3) sRGB image of what `sample` gave with the same settings.

        Raises:
            RenderError: There is no such light, or it could not be denoised.
        """
        light = _pass(rendered, COMBINED)
        if settings.denoise:
            if denoiser := self._own_denoiser():
                light = denoiser.denoise(light, *_guides(rendered, denoising), denoising)
            light = filter_denoised(light[..., :3], rendered.samples or settings.samples)
        return to_pixels(light, settings.view_transform, _exposure_ev(settings))

    def render_albedo(self, settings: RenderSettings, seconds: float = 0.0) -> NDArray[np.uint8]:
        """Return the (H, W, 3) sRGB-encoded reflectance that the scene's camera sees.

        Raises:
            RenderError: See `sample`.
        """
        layer = bpy.context.view_layer
        layer.use_pass_diffuse_color = True
        try:
            rendered = self._render(settings, seconds, denoise=False)
        finally:
            layer.use_pass_diffuse_color = False
        return encoded(np.ascontiguousarray(_pass(rendered, DIFFUSE_COLOR)))

    def _show_as(self, settings: RenderSettings) -> None:
        """Have a saved scene look as our images do."""
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
        is_own = denoise and self._own_denoiser() is not None
        layer = bpy.context.view_layer.cycles
        # Whatever is set marks the whole scene as changed.
        if layer.denoising_store_passes != is_own:
            layer.denoising_store_passes = is_own
        wanted: dict[str, Any] = {
            "samples": settings.samples,
            "time_limit": seconds,
            "seed": settings.seed,
            "use_denoising": denoise and not is_own,
            # Reflectance comes through the filter of its colours: to change it marks the scene.
            "filter_width": SAMPLED_WIDTH_PX if settings.denoise else CYCLES_WIDTH_PX,
        }
        for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
            wanted[f"{kind}_bounces"] = settings.max_bounces
        try:
            return render_scene(wanted)
        except RuntimeError as error:
            raise RenderError(f"Blender could not render: {error}") from error

    def _own_denoiser(self) -> Denoiser | None:
        return blenders_denoiser() if self.device == "cpu" else None


def _exposure_ev(settings: RenderSettings) -> float:
    return BASE_EXPOSURE_EV + settings.exposure_ev


def _guides(
    rendered: RenderResult, denoising: DenoisingQuality
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return what guides the denoiser, which makes them smooth itself where it is thorough."""
    albedo, normal = (_pass(rendered, name) for name in GUIDES)
    if denoising == "thorough":
        return albedo, normal
    return filter_guide(albedo), filter_guide(normal)


def _pass(rendered: RenderResult, name: str) -> NDArray[np.float32]:
    if name not in rendered.passes:
        raise RenderError(f"Blender rendered no pass {name}, only {sorted(rendered.passes)}")
    return rendered.passes[name]


VIEW_TRANSFORMS = {"agx": "AgX", "filmic": "Filmic", "standard": "Standard", "raw": "Raw"}
"""Blender's names of ours. All end in sRGB, but for raw, whose values are linear."""


def to_pixels(
    light: NDArray[np.float32], view_transform: ViewTransform, exposure_ev: float
) -> NDArray[np.uint8]:
    """Return the (H, W, 3) image of (H, W, 3 or 4) light: the values that Blender would write."""
    image = np.ascontiguousarray(light[..., :3])
    if exposure_ev:
        image = image * np.float32(2.0**exposure_ev)
    processor = _processor(view_transform)
    # OpenColorIO takes one thread for each part that it is given.
    with ThreadPoolExecutor(CORES) as pool:
        list(pool.map(processor.applyRGB, np.array_split(image, CORES)))
    np.clip(image, 0.0, 1.0, out=image)
    # As Blender rounds.
    return np.asarray(image * np.float32(255) + np.float32(0.5), dtype=np.uint8)


@cache
def _processor(view_transform: ViewTransform) -> Any:
    """Return what applies one of the view transforms that come with Blender."""
    folder = bpy.utils.system_resource("DATAFILES", path="colormanagement")
    config = PyOpenColorIO.Config.CreateFromFile(str(Path(folder) / "config.ocio"))
    transform = PyOpenColorIO.DisplayViewTransform(
        src=PyOpenColorIO.ROLE_SCENE_LINEAR,
        display=config.getDefaultDisplay(),
        view=VIEW_TRANSFORMS[view_transform],
    )
    return config.getProcessor(transform).getDefaultCPUProcessor()
