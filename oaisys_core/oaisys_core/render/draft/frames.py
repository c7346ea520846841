"""The colour modalities of a camera at the quality `draft`, for both backends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.color_frames import ColorFrames, Develop, color_frames
from oaisys_core.render.draft.appearance import Floats
from oaisys_core.render.draft.draft import DraftRenderer
from oaisys_core.scene import PlacedCamera
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.sensing.view_transforms import (
    BASE_EXPOSURE_EV,
    ExposedImage,
    exposure_of,
    show,
)

DRAFT = "draft"
"""Name of the quality."""


def develop(
    radiance: Floats, is_surface: NDArray[np.bool_], settings: RenderSettings
) -> ExposedImage:
    """Return the picture of (H, W, 3) radiance, without Blender."""
    exposure_ev = exposure_of(radiance, is_surface, settings)
    pixels = show(radiance, settings.view_transform, BASE_EXPOSURE_EV + exposure_ev)
    return ExposedImage(pixels, exposure_ev, radiance)


def draft_frames(
    renderer: DraftRenderer,
    surface: Surface,
    view: View,
    camera: PlacedCamera,
    settings: RenderSettings,
    develop: Develop,
) -> ColorFrames:
    """Return the frames of a view that show colours."""
    found = renderer.shade(surface, view, camera)
    seen = found.radiance, found.albedo, view.is_hit
    return color_frames(*seen, camera, surface.scene, settings, develop)
