"""What tests of lamps have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from unittest import mock

import bpy
import numpy as np
from numpy.typing import NDArray
from synthetic_worlds import settings

from oaisys_core.render.blender import BlenderBackend, cycles
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.sensing.view_transforms import BASE_EXPOSURE_EV
from oaisys_core.types import RGB, Progress
from tools.bench.cycles_passes import FILTER_WIDTH_PX


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def lambertian_views(
    scenes: Sequence[Scene], cameras: Sequence[PlacedCamera], samples: int
) -> list[NDArray[np.float64]]:
    """Linear colours, 0 to 1, of worlds on the same ground, each with its camera.

    Taken through the middle of the pixels, without a view transform or indirect light; diffuse
    materials are made ideal (without roughness).
    """
    backend = BlenderBackend()
    backend.build(scenes[0], ignore)
    for material in bpy.data.materials:
        for node in material.node_tree.nodes:
            if node.type == "BSDF_DIFFUSE":
                node.inputs["Roughness"].default_value = 0.0
    plain = settings(samples, exposure_ev=-BASE_EXPOSURE_EV)
    wanted = replace(plain, view_transform="raw", max_bounces=0)
    seen = []
    with mock.patch.object(cycles, "CYCLES_WIDTH_PX", FILTER_WIDTH_PX):
        for scene, camera in zip(scenes, cameras, strict=True):
            backend.update(scene)
            (frame,) = backend.render_all([camera], wanted, ignore)
            seen.append(frame.data / 255.0)
    return seen


def after_others(
    histories: Sequence[Sequence[Scene]], camera: PlacedCamera, samples: int
) -> list[bytes]:
    """The picture of the last scene of each history, in a backend that has rendered the others."""
    only_rgb = replace(camera, modalities=(RGB,))
    pictures = []
    for first, *others in histories:
        backend = BlenderBackend()
        backend.build(first, ignore)
        frames = backend.render_all([only_rgb], settings(samples), ignore)
        for scene in others:
            backend.update(scene)
            frames = backend.render_all([only_rgb], settings(samples), ignore)
        pictures.append(frames[0].data.tobytes())
    return pictures


def frames_of(scenes: Sequence[Scene], camera: PlacedCamera) -> list[list[NDArray[np.generic]]]:
    """All images of each scene, denoised."""
    backend = BlenderBackend()
    backend.build(scenes[0], ignore)
    found = []
    for scene in scenes:
        backend.update(scene)
        frames = backend.render_all([camera], replace(settings(2), denoise=True), ignore)
        found.append([frame.data for frame in frames])
    return found
