"""Cycles: how colour is rendered, and the pixels."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.base import RenderSettings
from oaisys_core.backend.blender.compat import DIFFUSE_COLOR, passes_format
from oaisys_core.color import encoded
from oaisys_core.errors import RenderError
from oaisys_core.exr import read_channels

VIEW_TRANSFORMS = {"agx": "AgX", "filmic": "Filmic", "standard": "Standard", "raw": "Raw"}
"""Blender's names of ours. All end in sRGB, but for raw, whose values are linear."""

BASE_EXPOSURE_EV = 0.6
"""Exposure at a setting of 0: dry ground in full sun comes out in the middle of the range."""


class Cycles:
    """Renders colour on the CPU with all cores, keeping the scene between views.

    Colours go through one of Blender's view transforms; AgX rolls bright parts off as film does.
    Pixels come out through an uncompressed file in a folder of its own: Blender gives no other
    access to the transformed image without a window.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="oaisys-")
        self._file = Path(self._folder.name) / "color.bmp"
        self._passes_file = Path(self._folder.name) / "passes.exr"
        self._settings: RenderSettings | None = None
        scene = bpy.context.scene
        render = scene.render
        render.engine = "CYCLES"
        render.use_persistent_data = True
        render.use_compositing = render.use_sequencer = False
        render.dither_intensity = 0.0
        render.image_settings.file_format = "BMP"
        render.image_settings.color_mode = "RGB"
        render.threads_mode = "AUTO"
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.use_adaptive_sampling = False
        cycles.sample_clamp_indirect = 10.0
        cycles.caustics_reflective = cycles.caustics_refractive = False
        cycles.denoiser = "OPENIMAGEDENOISE"
        cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
        cycles.denoising_prefilter = "FAST"
        # As good as the slower ones here: within 0.05 dB at 1 to 16 samples.
        cycles.denoising_quality = "FAST"

    def set(self, settings: RenderSettings, samples: int | None = None) -> None:
        """Change quality, exposure and seed; ``samples`` takes the place of the settings' own."""
        # What changes with each sample, such as the noise, is nothing to Cycles.
        wanted = replace(settings, noise_seed=0, samples=samples or settings.samples)
        if wanted == self._settings:
            return
        scene = bpy.context.scene
        cycles: Any = scene.cycles
        cycles.samples = wanted.samples
        cycles.seed = wanted.seed
        cycles.use_denoising = wanted.denoise
        for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
            setattr(cycles, f"{kind}_bounces", wanted.max_bounces)
        scene.view_settings.view_transform = VIEW_TRANSFORMS[wanted.view_transform]
        scene.view_settings.exposure = BASE_EXPOSURE_EV + wanted.exposure_ev
        # Persistent data keeps the old number of samples unless the scene is marked as changed.
        scene.update_tag()
        self._settings = wanted

    def forget(self) -> None:
        """Free what is kept between views: some of a world that went would stay there forever."""
        render = bpy.context.scene.render
        render.use_persistent_data = False
        render.use_persistent_data = True

    def render(self) -> NDArray[np.uint8]:
        """Return the (H, W, 3) sRGB image of the scene's camera.

        Raises:
            RenderError: Blender failed, or its image could not be written.
        """
        self._render_to(self._file)
        image = cv2.imread(str(self._file), cv2.IMREAD_COLOR)
        if image is None:
            raise RenderError(f"Blender wrote no image to {self._file}")
        return np.ascontiguousarray(image[..., ::-1])

    def render_albedo(self) -> NDArray[np.uint8]:
        """Return the (H, W, 3) sRGB-encoded reflectance that the scene's camera sees.

        Raises:
            RenderError: See `render`.
        """
        layer = bpy.context.view_layer
        layer.use_pass_diffuse_color = True
        use_denoising = bpy.context.scene.cycles.use_denoising
        bpy.context.scene.cycles.use_denoising = False
        try:
            with passes_format(bpy.context.scene.render.image_settings):
                self._render_to(self._passes_file)
        finally:
            layer.use_pass_diffuse_color = False
            bpy.context.scene.cycles.use_denoising = use_denoising
        channels = read_channels(self._passes_file)
        planes = [channels[f"{layer.name}.{DIFFUSE_COLOR}.{channel}"] for channel in "RGB"]
        return encoded(np.stack(planes, axis=-1))

    def _render_to(self, file: Path) -> None:
        file.unlink(missing_ok=True)
        try:
            bpy.ops.render.render()
            bpy.data.images["Render Result"].save_render(str(file))
        except RuntimeError as error:
            raise RenderError(f"Blender could not render: {error}") from error

    def close(self) -> None:
        """Remove the folder of its images."""
        self._folder.cleanup()
