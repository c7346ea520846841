"""The ground's albedo without noise, as a lens draws it that is a little out of focus."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.view import View
from oaisys_core.render.blender.camera import SENSOR_WIDTH_MM
from oaisys_core.render.blender.materials.ground.albedo import PixelAlbedo
from oaisys_core.render.render_result import Image
from oaisys_core.scene import Lens
from oaisys_core.types import FloatArray, PinholeIntrinsics

MOST_BLUR_PX = 2.0
"""Largest circle of confusion for which a pixel and its two neighbours suffice, and beyond which
what is beside a pixel may be something else."""


def blur_px(lens: Lens, intrinsics: PinholeIntrinsics, depth_m: FloatArray) -> FloatArray:
    """Return the circle of confusion of a thin lens: (..., 2) widths and heights in pixels.

    Args:
        lens: The lens; its f-number refers to a sensor `SENSOR_WIDTH_MM` wide.
        intrinsics: Without distortion.
        depth_m: (...) planar distances; what is infinitely far has NaN.
    """
    focal_length_m = intrinsics.fx_px / intrinsics.width_px * SENSOR_WIDTH_MM * 1e-3
    aperture_m = focal_length_m / lens.f_number * np.array((1 / lens.ratio, 1.0))
    with np.errstate(invalid="ignore"):
        out_of_focus = np.abs(depth_m / lens.focus_distance_m - 1) / depth_m
    return np.asarray(out_of_focus[..., None] * aperture_m * (intrinsics.fx_px, intrinsics.fy_px))


def albedo_behind(
    lens: Lens, intrinsics: PinholeIntrinsics, view: View, ground: PixelAlbedo
) -> PixelAlbedo:
    """Return the albedo behind a lens; it is known where the blur is at most `MOST_BLUR_PX`."""
    blur = blur_px(lens, intrinsics, view.depth_m)
    is_known = ground.is_known & (blur <= MOST_BLUR_PX).all(axis=-1)
    # Of a disc's width, the variance is the square of its diameter, divided by 16.
    share = np.where(is_known[..., None], blur, 0.0).astype(np.float32) ** 2 / 16
    linear = ground.linear
    for axis in (0, 1):
        beside = _mean_beside(linear, ground.is_known, axis)
        linear = linear + share[..., axis, None] * (beside - linear)
    return PixelAlbedo(linear, is_known)


def _mean_beside(image: Image, is_known: NDArray[np.bool_], axis: int) -> Image:
    """Return the mean of the known neighbours along a row (0) or column (1); else the pixel's."""
    beside, itself = np.array((1, 0, 1), np.float32), np.ones(1, np.float32)
    kernels = (beside, itself) if axis == 0 else (itself, beside)
    known = is_known.astype(np.float32)
    total = cv2.sepFilter2D(image * known[..., None], -1, *kernels, borderType=cv2.BORDER_REFLECT)
    count = cv2.sepFilter2D(known, -1, *kernels, borderType=cv2.BORDER_REFLECT)[..., None]
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), image))
