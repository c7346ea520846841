"""What tests of `draft` have done in Blender's own process."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from synthetic_worlds import settings

from oaisys_core.render.blender import BlenderBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import ALBEDO, RGB, Progress

SAMPLES = 64


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def both_ways(
    scene: Scene, camera: PlacedCamera, exposure_ev: float
) -> dict[str, NDArray[np.uint8]]:
    """The picture of a view as draft and by Cycles, the draft after a render, and its albedo."""
    backend = BlenderBackend()
    backend.build(scene, ignore)
    cycles = replace(settings(SAMPLES, exposure_ev=exposure_ev), view_transform="agx_contrast")
    draft = replace(cycles, quality="draft")
    seen = replace(camera, modalities=(RGB, ALBEDO))
    first, albedo = backend.render_all([seen], draft, ignore)
    (reference,) = backend.render_all([replace(camera, modalities=(RGB,))], cycles, ignore)
    again, _ = backend.render_all([seen], draft, ignore)
    return {
        "draft": first.data,
        "albedo": albedo.data,
        "cycles": reference.data,
        "again": again.data,
    }
