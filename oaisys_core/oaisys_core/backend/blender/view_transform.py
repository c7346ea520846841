"""From scene-linear light to pixel values, as Blender does it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import PyOpenColorIO
from numpy.typing import NDArray

from oaisys_core.backend.base import ViewTransform
from oaisys_core.backend.blender.background_geometry import CORES

VIEW_TRANSFORMS = {"agx": "AgX", "filmic": "Filmic", "standard": "Standard", "raw": "Raw"}
"""Blender's names of ours. All end in sRGB, but for raw, whose values are linear."""


def to_pixels(
    light: NDArray[np.float32], view_transform: ViewTransform, exposure_ev: float
) -> NDArray[np.uint8]:
    """Return the (H, W, 3) image of (H, W, 3 or 4) light: the values that Blender would write."""
    image = np.ascontiguousarray(light[..., :3])
    if exposure_ev:
        image = image * np.float32(2.0**exposure_ev)
    processor = _processor(view_transform)
    # OpenColorIO takes one thread for each part that it is given.
    with ThreadPoolExecutor(CORES) as pool:
        list(pool.map(processor.applyRGB, np.array_split(image, CORES)))
    np.clip(image, 0.0, 1.0, out=image)
    # As Blender rounds.
    return np.asarray(image * np.float32(255) + np.float32(0.5), dtype=np.uint8)


@cache
def _processor(view_transform: ViewTransform) -> Any:
    """Return what applies one of the view transforms that come with Blender."""
    folder = bpy.utils.system_resource("DATAFILES", path="colormanagement")
    config = PyOpenColorIO.Config.CreateFromFile(str(Path(folder) / "config.ocio"))
    transform = PyOpenColorIO.DisplayViewTransform(
        src=PyOpenColorIO.ROLE_SCENE_LINEAR,
        display=config.getDefaultDisplay(),
        view=VIEW_TRANSFORMS[view_transform],
    )
    return config.getProcessor(transform).getDefaultCPUProcessor()
