"""From radiance to a picture: exposure, and one of Blender's view transforms."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import PyOpenColorIO
from numpy.typing import NDArray

from oaisys_core.render.geometry_pass import CORES
from oaisys_core.sensing.render_settings import RenderSettings, ViewTransform
from oaisys_core.sensing.view_transforms import BASE_EXPOSURE_EV, ExposedImage, exposure_of

BANDS_PER_CORE = 4
"""Of rows of a picture, so that a core's cache holds one."""

RGB_CHANNELS = 3

VIEW_TRANSFORMS = {
    "agx_contrast": ("AgX", "AgX - Medium High Contrast"),
    "agx": ("AgX", "None"),
    "filmic": ("Filmic", "None"),
    "standard": ("Standard", "None"),
    "raw": ("Raw", "None"),
}
"""Blender's names of the view transforms and their looks; all of them give sRGB, except raw, which
is linear."""


def picture_of(
    radiance: NDArray[np.float32], is_surface: NDArray[np.bool_], settings: RenderSettings
) -> ExposedImage:
    """Return the picture of (H, W, 3 or 4) radiance.

    ``is_surface`` are the (H, W) pixels that do not show the sky, for the meter.
    """
    exposure_ev = exposure_of(radiance, is_surface, settings)
    pixels = to_pixels(radiance, settings.view_transform, BASE_EXPOSURE_EV + exposure_ev)
    return ExposedImage(pixels, exposure_ev, radiance)


def to_pixels(
    radiance: NDArray[np.float32], view_transform: ViewTransform, exposure_ev: float
) -> NDArray[np.uint8]:
    """Return the (H, W, 3) image that Blender would write of (H, W, 3 or 4) radiance."""
    pixels = np.empty((*radiance.shape[:2], 3), np.uint8)
    gain = np.float32(2.0**exposure_ev)
    processor = _processor(view_transform)
    height_px, width_px = pixels.shape[:2]

    def develop(rows: slice) -> None:
        exposed = np.ascontiguousarray(radiance[rows, :, :3] * gain)
        shown = pixels[rows]
        processor.apply(
            PyOpenColorIO.PackedImageDesc(exposed, width_px, len(exposed), RGB_CHANNELS),
            PyOpenColorIO.PackedImageDesc(
                shown,
                width_px,
                len(shown),
                PyOpenColorIO.CHANNEL_ORDERING_RGB,
                PyOpenColorIO.BIT_DEPTH_UINT8,
                1,
                RGB_CHANNELS,
                RGB_CHANNELS * width_px,
            ),
        )

    rows = max(-(-height_px // (BANDS_PER_CORE * CORES)), 1)
    # OpenColorIO itself uses one thread per call.
    with ThreadPoolExecutor(CORES) as pool:
        list(pool.map(develop, (slice(i, i + rows) for i in range(0, height_px, rows))))
    return pixels


@cache
def _processor(view_transform: ViewTransform) -> Any:
    """Return OpenColorIO's processor of one of Blender's view transforms, from floats to bytes.

    It rounds as Blender does.
    """
    folder = bpy.utils.system_resource("DATAFILES", path="colormanagement")
    config = PyOpenColorIO.Config.CreateFromFile(str(Path(folder) / "config.ocio"))
    view, look = VIEW_TRANSFORMS[view_transform]
    pipeline = PyOpenColorIO.LegacyViewingPipeline()
    pipeline.setDisplayViewTransform(
        PyOpenColorIO.DisplayViewTransform(
            src=PyOpenColorIO.ROLE_SCENE_LINEAR, display=config.getDefaultDisplay(), view=view
        )
    )
    if look != "None":
        pipeline.setLooksOverrideEnabled(True)
        pipeline.setLooksOverride(look)
    return pipeline.getProcessor(config, config.getCurrentContext()).getOptimizedCPUProcessor(
        PyOpenColorIO.BIT_DEPTH_F32,
        PyOpenColorIO.BIT_DEPTH_UINT8,
        PyOpenColorIO.OPTIMIZATION_DEFAULT,
    )
