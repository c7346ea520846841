"""The colour modalities of a camera at the quality `draft`, for both backends."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.color import encode_srgb
from oaisys_core.procedural.environment.light import white_gains
from oaisys_core.raycast.surface import Surface, View
from oaisys_core.render.draft.appearance import Floats
from oaisys_core.render.draft.draft import DraftRenderer
from oaisys_core.render.geometry_pass import frame_of
from oaisys_core.render.light_images import light_images
from oaisys_core.scene import PlacedCamera
from oaisys_core.sensing.effects import with_effects
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.sensing.view_transforms import (
    BASE_EXPOSURE_EV,
    ExposedImage,
    exposure_of,
    show,
)
from oaisys_core.types import ALBEDO, RGB, Frame

DRAFT = "draft"
"""Name of the quality."""


class DraftFrames(NamedTuple):
    """The frames of a view that show colours, and its exposures as `Backend.exposures` has them."""

    frames: tuple[Frame, ...]
    exposures: dict[str, float]


Develop = Callable[[Floats, NDArray[np.bool_], RenderSettings], ExposedImage]
"""Returns the picture of (H, W, 3) radiance, given the pixels that do not show the sky."""


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
) -> DraftFrames:
    """Return the frames of a view that show colours."""
    found, scene = renderer.shade(surface, view, camera), surface.scene
    frames, exposures = [], {}
    if RGB in camera.modalities:
        radiance = found.radiance
        if settings.white_balance == "illuminant":
            radiance = radiance * np.array(white_gains(scene.sky, scene.lamps), np.float32)
        picture = develop(radiance, view.is_hit, settings)
        exposures[camera.name] = picture.exposure_ev
        rng = randomness.stream(settings.noise_seed, camera.name)
        image = with_effects(picture.pixels, settings.effects, camera.intrinsics, rng)
        frames.append(frame_of(camera, RGB, image))
    physical = light_images(found.radiance, camera, scene.sky, settings.noise_seed)
    frames += [frame_of(camera, *each) for each in physical.images.items()]
    if ALBEDO in camera.modalities:
        frames.append(frame_of(camera, ALBEDO, encode_srgb(found.albedo)))
    return DraftFrames(tuple(frames), exposures | physical.exposures)
