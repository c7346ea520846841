"""What tests of light and air have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from unittest import mock

import bpy
import numpy as np
from coarse_clouds import coarse_clouds
from numpy.typing import NDArray
from synthetic_worlds import settings

from oaisys_core.render.blender import BlenderBackend, cycles
from oaisys_core.render.blender.objects import sky as sky_objects
from oaisys_core.scene import PlacedCamera, Scene, Sky
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.sensing.view_transforms import BASE_EXPOSURE_EV
from oaisys_core.types import RADIANCE, RGB, Progress
from tools.bench.cycles_passes import FILTER_WIDTH_PX


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def linear_views(
    scene: Scene, cameras: Sequence[PlacedCamera], skies: Sequence[Sky], samples: int = 1
) -> list[NDArray[np.float64]]:
    """Linear colours, 0 to 1, of a world under several skies, camera by camera for each sky.

    Taken through the middle of the pixels, without a view transform; clouds are `coarse_clouds`.
    """
    backend = BlenderBackend()
    wanted = replace(settings(samples, exposure_ev=-BASE_EXPOSURE_EV), view_transform="raw")
    seen = []
    through_middle = mock.patch.object(cycles, "CYCLES_WIDTH_PX", FILTER_WIDTH_PX)
    with through_middle, coarse_clouds():
        backend.build(replace(scene, sky=skies[0]), ignore)
        for sky in skies:
            far_ground = scene.far_ground if sky.shows_plain else None
            backend.update(replace(scene, sky=sky, far_ground=far_ground))
            for camera in cameras:
                only_rgb = replace(camera, modalities=(RGB,))
                (frame,) = backend.render_all([only_rgb], wanted, ignore)
                seen.append(frame.data / 255.0)
    return seen


def has_sky_after_a_failure(sky: Sky, other: Sky) -> bool:
    """Whether Blender's world has the image of a sky that is set again after another failed."""
    lights = sky_objects.Lights()
    lights.set(sky, None)
    shortage = mock.patch.object(sky_objects, "_new_image", side_effect=MemoryError)
    with shortage, suppress(MemoryError):
        lights.set(other, None)
    lights.set(sky, None)
    nodes = bpy.context.scene.world.node_tree.nodes
    images = [node.image for node in nodes if node.type == "TEX_ENVIRONMENT"]
    names = [image.name.partition(".")[0] for image in images]  # ".001" beside one of that name
    return names == [sky.hdri.image.name if sky.hdri else ""]


def linear_worlds(
    scenes: Sequence[Scene], camera: PlacedCamera, samples: int
) -> list[NDArray[np.float64]]:
    """Linear colours, 0 to 1, of one view in each of several worlds."""
    return [linear_views(scene, [camera], [scene.sky], samples)[0] for scene in scenes]


def metered_pictures(
    scene: Scene, camera: PlacedCamera, skies: Sequence[Sky], wanted: RenderSettings
) -> list[tuple[NDArray[np.uint8], float]]:
    """Pictures of a view under several skies, one after the other, and their exposures in stops."""
    backend = BlenderBackend()
    backend.build(scene, ignore)
    found = []
    for sky in skies:
        backend.update(replace(scene, sky=sky))
        (frame,) = backend.render_all([replace(camera, modalities=(RGB,))], wanted, ignore)
        found.append((frame.data, backend.exposures[camera.name]))
    return found


def radiances(
    scenes: Sequence[Scene], camera: PlacedCamera, samples: int
) -> list[NDArray[np.float32]]:
    """Radiance images of one view in each of several worlds."""
    backend = BlenderBackend()
    found = []
    for scene in scenes:
        backend.build(scene, ignore)
        view = replace(camera, modalities=(RADIANCE,))
        (frame,) = backend.render_all([view], settings(samples), ignore)
        found.append(frame.data)
    return found
