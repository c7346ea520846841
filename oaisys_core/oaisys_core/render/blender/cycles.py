"""Colour images by Cycles, without a scene update for each setting and without image files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb
from oaisys_core.errors import RenderError
from oaisys_core.render.blender.compat import DIFFUSE_COLOR
from oaisys_core.render.blender.cycles_render import render_scene
from oaisys_core.render.blender.devices import use_device
from oaisys_core.render.blender.materials.ground.albedo import PixelAlbedo
from oaisys_core.render.blender.materials.ground.narrow_patches import Patches
from oaisys_core.render.blender.materials.mesh_materials import CUT_OUT_LAYERS, has_cut_outs
from oaisys_core.render.blender.postprocessing import (
    BACKGROUND_M,
    CYCLES_WIDTH_PX,
    DEPTH,
    SAMPLED_WIDTH_PX,
    Denoiser,
    blenders_denoiser,
    denoise_image,
)
from oaisys_core.render.blender.time_budget import DenoisingQuality
from oaisys_core.render.blender.tone_mapping import (
    VIEW_TRANSFORMS,
    picture_of,
)
from oaisys_core.render.render_result import RenderResult, pass_of
from oaisys_core.scene.sky import Color
from oaisys_core.sensing.render_settings import Device, RenderSettings
from oaisys_core.sensing.view_transforms import BASE_EXPOSURE_EV, ExposedImage

SHORTEST_PATTERN, LONGEST_PATTERN = 256, 8192
"""Lengths of the table of Cycles' sampling pattern, which is a power of two."""


class Cycles:
    """Renders colour, and keeps Cycles' copy of the scene between views."""

    def __init__(self) -> None:
        self._wanted: Device | None = None
        self._pattern_length = 0
        self._lights: tuple[object, ...] = ()
        self._last_exposure_ev = 0.0
        self.device: Device = "cpu"
        scene = bpy.context.scene
        render = scene.render
        render.engine = "CYCLES"
        render.use_persistent_data = True
        render.use_compositing = render.use_sequencer = False
        layer = bpy.context.view_layer
        # The meter tells the sky by it.
        layer.use_pass_z = True
        # For the denoiser, and to tell ground whose shader failed.
        layer.cycles.denoising_store_passes = True
        # Denoising takes them where samples are reflected by chance.
        layer.use_pass_material_index = layer.use_pass_normal = True
        layer.use_pass_diffuse_color = layer.use_pass_glossy_color = True
        # They are those of the first surface, however clear it is.
        layer.pass_alpha_threshold = 0.0
        render.threads_mode = "AUTO"
        cycles = scene.cycles
        cycles.use_adaptive_sampling = False
        # There is only the sun to sample, see `use_lamps`.
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
        self._pattern_length = 0

    def use_lamps(self, kinds: Sequence[str], *, has_sun: bool) -> None:
        """Say which lights the scene has: the kinds of its lamps in their order, and the sun.

        Cycles keeps lights in the order in which it met them, on which its sampling depends. It
        starts anew where other lights might have left another order.
        """
        lights = (has_sun, *kinds) if kinds else ()
        if lights == self._lights:
            return
        self._lights = lights
        bpy.context.scene.cycles.use_light_tree = bool(kinds)
        self.free_persistent_data()

    def render_radiance(self, settings: RenderSettings, seconds: float = 0.0) -> RenderResult:
        """Render the radiance that the scene's camera sees, and what `albedo_of` needs.

        Args:
            settings: Quality, exposure and seed.
            seconds: Time limit of sampling, after at least one sample per pixel; 0: none.

        Raises:
            RenderError: Blender failed.
        """
        self._show_as(settings)
        return self._render(settings, seconds, denoise=settings.denoise)

    def denoise_and_tonemap(
        self,
        rendered: RenderResult,
        settings: RenderSettings,
        denoising: DenoisingQuality,
        ground: PixelAlbedo | None = None,
        gains: Color | None = None,
        patches: Patches | None = None,
    ) -> ExposedImage:
        """Return the picture of what `render_radiance` gave with the same settings.

        Args:
            rendered: The passes.
            settings: Those of the render.
            denoising: See `Denoiser.denoise`.
            ground: Albedo without noise, where it is known.
            gains: Factors on red, green and blue for the white balance.
            patches: The ground's, see `share_albedo`.

        Raises:
            RenderError: The passes are missing, or denoising failed.
        """
        radiance = denoise_image(rendered, settings, self._denoiser(), denoising, ground, patches)
        shown = radiance if gains is None else radiance[..., :3] * np.array(gains, np.float32)
        is_surface = pass_of(rendered, DEPTH)[..., 0] < BACKGROUND_M
        picture = picture_of(shown, is_surface, settings)._replace(radiance=radiance[..., :3])
        self._last_exposure_ev = picture.exposure_ev
        return picture

    def show_last_exposure(self) -> None:
        """Set Blender's exposure to that of the last picture, for a scene that is saved."""
        bpy.context.scene.view_settings.exposure = BASE_EXPOSURE_EV + self._last_exposure_ev

    def render_albedo(self, settings: RenderSettings, seconds: float = 0.0) -> RenderResult:
        """Render the albedo that the scene's camera sees, see `albedo_of`.

        Raises:
            RenderError: See `render_radiance`.
        """
        return self._render(settings, seconds, denoise=False)

    def _show_as(self, settings: RenderSettings) -> None:
        """Set Blender's view transform, so that a saved scene looks like the images."""
        view = bpy.context.scene.view_settings
        view_transform, look = VIEW_TRANSFORMS[settings.view_transform]
        if (view.view_transform, view.look) != (view_transform, look):
            view.view_transform, view.look = view_transform, look

    def _render(self, settings: RenderSettings, seconds: float, denoise: bool) -> RenderResult:
        if settings.device != self._wanted:
            self._wanted, self.device = settings.device, use_device(settings.device)
        denoise_after = denoise and self._denoiser() is not None
        wanted: dict[str, Any] = {
            "samples": settings.samples,
            "time_limit": seconds,
            "seed": settings.seed,
            "use_denoising": denoise and not denoise_after,
            # The same for albedo and colour, because a change marks the whole scene as changed.
            "filter_width": SAMPLED_WIDTH_PX if settings.denoise else CYCLES_WIDTH_PX,
        }
        self._prepare_pattern(settings.samples)
        for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
            wanted[f"{kind}_bounces"] = settings.max_bounces
        if has_cut_outs():
            wanted["transparent_max_bounces"] = max(CUT_OUT_LAYERS, settings.max_bounces)
        try:
            return render_scene(wanted)
        except RenderError:
            # Cycles keeps what failed, and would not say so again.
            self.free_persistent_data()
            raise

    def _prepare_pattern(self, samples: int) -> None:
        """Have Cycles start anew where its table of the sampling pattern is too long.

        Cycles only ever lengthens the table, whose values depend on its length: a picture would
        depend on those before it.
        """
        length = 1 << (samples - 1).bit_length()
        length = min(max(length, SHORTEST_PATTERN), LONGEST_PATTERN)
        if length < self._pattern_length:
            self.free_persistent_data()
        self._pattern_length = length

    def _denoiser(self) -> Denoiser | None:
        """Return the denoiser that runs after Cycles; None on a GPU, where Cycles denoises."""
        return blenders_denoiser() if self.device == "cpu" else None


def albedo_of(rendered: RenderResult) -> NDArray[np.uint8]:
    """Return the (H, W, 3) sRGB-encoded albedo of a render that kept it."""
    return encode_srgb(np.ascontiguousarray(pass_of(rendered, DIFFUSE_COLOR)))
