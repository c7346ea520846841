"""Where Blender's 32-bit coordinates are too coarse for a camera."""

from __future__ import annotations

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import unproject
from oaisys_core.raycast.surface import Surface
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FloatArray

MAX_SHIFT_PX = 0.5
"""By how much colour may lie beside depth, which is computed with 64 bits."""

NEAR_M = 0.1
"""Surfaces that are nearer are not looked for: at 1 km from the origin they are exact enough."""

COLUMNS, ROWS = 48, 36
"""Rays over the image that look for the nearest surface."""

FARTHEST_M = 1e6


def check_precision(surface: Surface, camera: PlacedCamera) -> None:
    """Raise if colour would leave depth, because a camera is far from the origin of ``map``.

    Blender rounds the camera and the surfaces beside it to 32-bit floats, each by up to half of
    their spacing, which is 16 mm at 200 km. On the image that is, at most, this spacing times the
    focal length in pixels over the distance of the nearest surface.

    Raises:
        InvalidInputError: That is more than `MAX_SHIFT_PX`.
    """
    position_m = camera.T_map_camera[:3, 3]
    spacing_m = float(np.spacing(np.float32(np.abs(position_m).max())))
    focal_px = max(camera.intrinsics.fx_px, camera.intrinsics.fy_px)
    least_m = focal_px * spacing_m / MAX_SHIFT_PX
    if least_m < NEAR_M:
        return
    nearest_m = _nearest_m(surface, camera)
    if nearest_m >= least_m:
        return
    shift_px = focal_px * spacing_m / nearest_m
    expected = (
        f"a pose nearer to the origin of map: there, 32-bit coordinates are {spacing_m:.2g} m"
        f" apart, which at a surface {nearest_m:.3g} m away is {shift_px:.2g}"
        f" pixels of the colour of {camera.name!r}, more than {MAX_SHIFT_PX}"
    )
    raise InvalidInputError("pose.position", [float(each) for each in position_m], expected)


def _nearest_m(surface: Surface, camera: PlacedCamera) -> float:
    """Return the distance of the nearest surface in an image; inf if there is none."""
    size = camera.intrinsics
    u = np.linspace(0, size.width_px - 1, min(COLUMNS, size.width_px))
    v = np.linspace(0, size.height_px - 1, min(ROWS, size.height_px))
    pixels: FloatArray = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = unproject(pixels, np.ones(len(pixels)), size)
    rays = rays[np.isfinite(rays).all(axis=1)]
    directions = rays / np.linalg.norm(rays, axis=1)[:, None] @ camera.T_map_camera[:3, :3].T
    view = surface.cast(camera.T_map_camera[:3, 3], directions, FARTHEST_M)
    return float(np.min(view.depth_m, initial=np.inf))
