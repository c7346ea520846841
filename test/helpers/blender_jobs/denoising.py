"""What tests of denoising have done in Blender's own process, see `blender_process.in_blender`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest import mock

import bpy  # noqa: F401 - brings the library
import numpy as np
from numpy.typing import NDArray
from synthetic_worlds import camera, rocky_world, settings

from oaisys_core.errors import CancelledError
from oaisys_core.geometry import pose_looking_at
from oaisys_core.render.blender import BlenderBackend, compat, cycles, postprocessing
from oaisys_core.render.blender.materials.ground.albedo import PixelAlbedo
from oaisys_core.render.blender.postprocessing import blenders_denoiser
from oaisys_core.render.blender.time_budget import DENOISING_COSTS, DenoisingQuality
from oaisys_core.render.render_result import RenderResult
from oaisys_core.system.ending.interruption import interruptible
from oaisys_core.types import RGB

Image = NDArray[np.float32]


def denoised(light: Image, normal: Image) -> dict[str, Any]:
    """Light by each denoising, again after others, and what is said of normals of another size."""
    denoiser = blenders_denoiser()
    if denoiser is None:
        raise AssertionError("Blender came without its denoiser")
    found: dict[str, Any] = {
        denoising: denoiser.denoise(light, normal, denoising) for denoising in DENOISING_COSTS
    }
    dark = denoiser.denoise(0.5 * light, normal, "fast")
    found["after another"] = denoiser.denoise(light, normal, "fast")
    denoiser.denoise(light[1:], normal[1:], "fast")
    found["after another size"] = denoiser.denoise(light, normal, "fast")
    found["dark"] = dark
    try:
        denoiser.denoise(light, normal[1:], "thorough")
    except ValueError as error:
        found["error"] = str(error)
    try:
        with interruptible(_cancel):
            denoiser.denoise(dark, normal, "fast")
    except CancelledError as error:
        found["cancelled"] = str(error)
    found["after cancelling"] = denoiser.denoise(light, normal, "fast")
    return found


def _cancel() -> None:
    raise CancelledError("enough")


def of_passes(
    radiance: Image,
    albedo: Image,
    normal: Image,
    denoising: DenoisingQuality,
    ground: Image | None = None,
    samples: int = 1,
) -> Image:
    """The radiance of a render's passes, denoised as a view's is; ``ground`` is a known albedo."""
    known = None
    if ground is not None:
        known = PixelAlbedo(ground, np.ones(ground.shape[:2], bool))
    nothing = np.zeros((*radiance.shape[:2], 1), np.float32)
    passes = {
        "Combined": radiance,
        "Denoising Albedo": albedo,
        "Denoising Normal": normal,
        compat.MATERIAL_INDEX: nothing,
        compat.GLOSSY_COLOR: np.zeros_like(radiance),
    }
    wanted = replace(settings(samples), denoise=True)
    return postprocessing.denoise_image(
        RenderResult(passes, samples=samples), wanted, blenders_denoiser(), denoising, known
    )


def filtered(image: Image, samples: int = 1) -> Image:
    """An image after the second step of the pixel filter."""
    return postprocessing.filter_denoised(image, samples)


def pictures() -> dict[str, NDArray[np.uint8]]:
    """One view with few samples: noisy, denoised by either library's user; and with many."""
    scene = rocky_world()
    view = camera(pose_looking_at((-6, -5, 3), (2, 1, 0)), modalities=(RGB,))
    few = replace(settings(4), denoise=True)
    backend = BlenderBackend()
    backend.build(scene, lambda _: None)

    def picture(wanted: Any) -> NDArray[np.uint8]:
        return np.asarray(backend.render_all([view], wanted, lambda _: None)[0].data)

    found = {
        "noisy": picture(settings(4)),
        "denoised": picture(few),
        "again": picture(few),
        "thorough": picture(replace(few, samples=16)),
        "converged": picture(settings(256)),
    }
    with mock.patch.object(cycles, "blenders_denoiser", return_value=None):
        found["by cycles"] = picture(few)
    return found
