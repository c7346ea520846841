"""Images of other pixels than the camera's: for a lens that distorts, or where time is short."""

from __future__ import annotations

from math import ceil, sqrt
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import pixel_rays
from oaisys_core.types import PinholeIntrinsics

MARGIN_PX = 3
"""Pixels around what the lens sees, for the interpolation's sake."""

MOST_PIXELS = 4.0
"""Pixels of the pinhole image, at most, in those of the lens's; beyond, it is coarser."""


def covering_pinhole(intrinsics: PinholeIntrinsics) -> PinholeIntrinsics:
    """Return a pinhole camera of the same optical frame that sees all that a lens does.

    Its pixels are at least as fine as the lens's, within `MOST_PIXELS`.
    """
    rays = pixel_rays(intrinsics)[..., :2]
    low, high = rays.min(axis=(0, 1)), rays.max(axis=(0, 1))
    finest = (np.diff(rays[..., 0], axis=1).min(), np.diff(rays[..., 1], axis=0).min())
    focal_px = 1.0 / np.array(finest)
    size_px = (high - low) * focal_px + 1 + 2 * MARGIN_PX
    surplus = size_px.prod() / (MOST_PIXELS * intrinsics.width_px * intrinsics.height_px)
    if surplus > 1:
        focal_px /= sqrt(surplus)
        size_px = (high - low) * focal_px + 1 + 2 * MARGIN_PX
    cx_px, cy_px = MARGIN_PX - low * focal_px
    width, height = (ceil(size) for size in size_px.tolist())
    fx_px, fy_px = focal_px.tolist()
    return PinholeIntrinsics(width, height, fx_px, fy_px, float(cx_px), float(cy_px))


def scaled_pinhole(pinhole: PinholeIntrinsics, scale: float) -> PinholeIntrinsics:
    """Return a camera that sees the same with ``scale`` times as many pixels along each side."""
    if scale == 1.0:
        return pinhole
    width_px = max(1, round(pinhole.width_px * scale))
    height_px = max(1, round(pinhole.height_px * scale))
    across, down = width_px / pinhole.width_px, height_px / pinhole.height_px
    return PinholeIntrinsics(
        width_px,
        height_px,
        pinhole.fx_px * across,
        pinhole.fy_px * down,
        # Pixel centres are at integers: the image's edge is at -0.5.
        (pinhole.cx_px + 0.5) * across - 0.5,
        (pinhole.cy_px + 0.5) * down - 0.5,
    )


def distorted_image(
    image: NDArray[Any], pinhole: PinholeIntrinsics, intrinsics: PinholeIntrinsics
) -> NDArray[Any]:
    """Return, of an image by `covering_pinhole`, the one that the lens makes."""
    rays = pixel_rays(intrinsics)
    u = (rays[..., 0] * pinhole.fx_px + pinhole.cx_px).astype(np.float32)
    v = (rays[..., 1] * pinhole.fy_px + pinhole.cy_px).astype(np.float32)
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
