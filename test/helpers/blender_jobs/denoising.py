"""What tests of denoising have done in Blender's own process, see `blender_process.in_blender`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest import mock

import bpy  # noqa: F401 - brings the library
import numpy as np
from numpy.typing import NDArray
from synthetic_worlds import camera, rocky_world, settings

from oaisys_core.backend.blender import BlenderBackend, cycles
from oaisys_core.backend.blender.postprocessing import blenders_denoiser
from oaisys_core.backend.blender.time_budget import DENOISING_COSTS
from oaisys_core.errors import CancelledError
from oaisys_core.geometry import pose_looking_at
from oaisys_core.interruption import interruptible
from oaisys_core.types import RGB

Image = NDArray[np.float32]


def denoised(color: Image, albedo: Image, normal: Image) -> dict[str, Any]:
    """A picture by each denoising, again after others, and what is said about guides of another."""
    denoiser = blenders_denoiser()
    if denoiser is None:
        raise AssertionError("Blender came without its denoiser")
    found: dict[str, Any] = {
        denoising: denoiser.denoise(color, albedo, normal, denoising)
        for denoising in DENOISING_COSTS
    }
    dark = denoiser.denoise(0.5 * color, albedo, normal, "fast")
    found["after another"] = denoiser.denoise(color, albedo, normal, "fast")
    denoiser.denoise(color[1:], albedo[1:], normal[1:], "fast")
    found["after another size"] = denoiser.denoise(color, albedo, normal, "fast")
    found["dark"] = dark
    try:
        denoiser.denoise(color, albedo[1:], normal, "thorough")
    except ValueError as error:
        found["error"] = str(error)
    try:
        with interruptible(_cancel):
            denoiser.denoise(dark, albedo, normal, "fast")
    except CancelledError as error:
        found["cancelled"] = str(error)
    found["after cancelling"] = denoiser.denoise(color, albedo, normal, "fast")
    return found


def _cancel() -> None:
    raise CancelledError("enough")


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
