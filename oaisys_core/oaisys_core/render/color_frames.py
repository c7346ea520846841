"""The frames of a view that show colours, from the radiance and albedo of its rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.color import encode_srgb
from oaisys_core.procedural.environment.light import white_gains
from oaisys_core.render.geometry_pass import frame_of
from oaisys_core.render.light_images import light_images
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.sensing.effects import with_effects
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.sensing.view_transforms import ExposedImage
from oaisys_core.types import ALBEDO, RGB, Frame

Develop = Callable[[NDArray[Any], NDArray[np.bool_], RenderSettings], ExposedImage]
"""Returns the picture of (H, W, 3) radiance, given the pixels that do not show the sky."""


class ColorFrames(NamedTuple):
    """The frames of a view that show colours, and its exposures as `Backend.exposures` has them."""

    frames: tuple[Frame, ...]
    exposures: dict[str, float]


def color_frames(
    radiance: NDArray[Any],
    albedo: NDArray[Any],
    is_surface: NDArray[np.bool_],
    camera: PlacedCamera,
    scene: Scene,
    settings: RenderSettings,
    develop: Develop,
) -> ColorFrames:
    """Return those of a camera's frames that show colours.

    Args:
        radiance: (H, W, 3) in scene units; anything if no image of the camera depends on light.
        albedo: (H, W, 3) linear; anything if the camera has no image of it.
        is_surface: (H, W) pixels that do not show the sky.
        camera: The camera.
        scene: The world.
        settings: How to render.
        develop: Exposes the picture and gives it its contrast.
    """
    frames, exposures = [], {}
    if RGB in camera.modalities:
        light = radiance
        if settings.white_balance == "illuminant":
            light = light * np.array(white_gains(scene.sky, scene.lamps), light.dtype)
        picture = develop(light, is_surface, settings)
        exposures[camera.name] = picture.exposure_ev
        rng = randomness.stream(settings.noise_seed, camera.name)
        image = with_effects(picture.pixels, settings.effects, camera.intrinsics, rng)
        frames.append(frame_of(camera, RGB, image))
    physical = light_images(radiance, camera, scene.sky, settings.noise_seed)
    frames += [frame_of(camera, *each) for each in physical.images.items()]
    if ALBEDO in camera.modalities:
        frames.append(frame_of(camera, ALBEDO, encode_srgb(albedo)))
    return ColorFrames(tuple(frames), exposures | physical.exposures)
