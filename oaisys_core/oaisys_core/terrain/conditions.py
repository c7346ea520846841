"""The relief of a ground as its material sees it: where layers may lie, and where it is steep."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from oaisys_core.scene import Ground
from oaisys_core.terrain.noise import Field

SLOPE_SCALE_M = 0.25
"""Slopes are taken of the ground smoothed by this deviation: pebbles do not make it steep."""

STEEP_DEG = 50.0
STEEP_SHARE = 0.002
"""A ground has steep parts where more than this share of it is steeper than the angle."""

COARSE_PX = 256
"""Grid on which a ground is looked at for steep parts."""


class Relief(NamedTuple):
    """Heights and slopes at the texels of a mask, both (M, M) float32."""

    height_m: Field
    slope_rad: Field


def relief_of(ground: Ground, size_px: int) -> Relief:
    """Return a ground's relief at the centres of a size_px x size_px grid over its extent."""
    x0, y0, x1, y1 = ground.extent_m
    step_x, step_y = (x1 - x0) / size_px, (y1 - y0) / size_px
    centres = np.arange(size_px) + 0.5
    x, y = np.meshgrid(x0 + centres * step_x, y0 + centres * step_y)
    height_m = ground.height_at(np.column_stack((x.ravel(), y.ravel()))).reshape(x.shape)
    # A ground may have no surface at the edges of its extent.
    height_m = np.where(np.isfinite(height_m), height_m, np.nanmean(height_m))
    sigma = (SLOPE_SCALE_M / step_y, SLOPE_SCALE_M / step_x)
    smooth_m = gaussian_filter(height_m, sigma, mode="nearest")
    up_y, up_x = np.gradient(smooth_m, step_y, step_x)
    return Relief(height_m.astype(np.float32), np.arctan(np.hypot(up_x, up_y)).astype(np.float32))


def has_steep_parts(ground: Ground) -> bool:
    """Return whether textures laid on the ground from above would be drawn out visibly."""
    slope_rad = relief_of(ground, COARSE_PX).slope_rad
    return bool((slope_rad > np.radians(STEEP_DEG)).mean() > STEEP_SHARE)
