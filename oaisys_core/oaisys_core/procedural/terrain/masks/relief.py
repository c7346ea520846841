"""The relief by which the ground's layers lie: heights, slopes, and how exposed the ground is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.scene import Ground

SLOPE_SCALE_M = 0.25
"""Standard deviation of the smoothing before slopes are computed, to ignore pebbles."""

STEEP_DEG = 50.0
STEEP_SHARE = 0.002
"""A ground has steep parts if more than this share of it is steeper than the angle."""

COARSE_PX = 256
"""Grid size for the search for steep parts."""

RELIEF_PX = 256
"""Grid size at which it is measured which layers lie on slopes and on ridges, and at which patches
follow the ground's forms."""

FORMS = (0.5, 1.5, 4.0)
"""Sizes of forms that stand out of the ground around, in units of a patch."""

MIN_RISE = 0.02
"""Standard deviation of the height, in units of a form's size, below which forms count less."""

REPOSE_RAD = 0.35, 0.7
"""Slopes from which on loose material stays less and less, 20 degrees, and hardly at all, 40."""

STEEPNESS = 3.0
"""Weight of the slope, that of each size of forms being 1."""

MAX_DEVIATION = 2.0
"""Largest deviation from the mean that counts."""


class Relief(NamedTuple):
    """Heights and slopes at the texels of a mask, both (M, M) float32."""

    height_m: Field
    slope_rad: Field


def relief_of(ground: Ground, size_px: int) -> Relief:
    """Return the relief at the cell centres of a size_px x size_px grid over the ground."""
    x0, y0, x1, y1 = ground.extent_m
    step_x, step_y = (x1 - x0) / size_px, (y1 - y0) / size_px
    centres = np.arange(size_px) + 0.5
    x, y = np.meshgrid(x0 + centres * step_x, y0 + centres * step_y)
    height_m = ground.height_at(np.column_stack((x.ravel(), y.ravel()))).reshape(x.shape)
    # A ground may have no surface at the edges of its extent.
    height_m = np.where(np.isfinite(height_m), height_m, np.nanmean(height_m))
    sigma = (SLOPE_SCALE_M / step_y, SLOPE_SCALE_M / step_x)
    smooth_m = scipy.ndimage.gaussian_filter(height_m, sigma, mode="nearest")
    up_y, up_x = np.gradient(smooth_m, step_y, step_x)
    return Relief(height_m.astype(np.float32), np.arctan(np.hypot(up_x, up_y)).astype(np.float32))


def has_steep_parts(ground: Ground) -> bool:
    """Return whether the ground is steep enough to stretch textures projected from above."""
    slope_rad = relief_of(ground, COARSE_PX).slope_rad
    return bool((slope_rad > np.radians(STEEP_DEG)).mean() > STEEP_SHARE)


def exposure(relief: Relief, texel_m: float, patch_m: float) -> Field:
    """Return (M, M) float32 how exposed the ground is: high beside its surroundings, and steep.

    Ridges, brinks and scarps have positive values, hollows and level ground negative ones; the
    standard deviation is at most 1, and less on ground without forms.

    Args:
        relief: Of M x M texels.
        texel_m: Edge length of a texel.
        patch_m: Size of the patches that follow the forms.
    """
    height_m = _level(relief.height_m)
    total = np.zeros_like(height_m)
    for form in FORMS:
        size_m = form * patch_m
        raised_m = height_m - _smooth(height_m, size_m / texel_m)
        unit_m = np.float32(max(float(raised_m.std()), MIN_RISE * size_m))
        total += np.clip(raised_m / unit_m, -MAX_DEVIATION, MAX_DEVIATION)
    least_rad, most_rad = (np.float32(bound) for bound in REPOSE_RAD)
    steepness = np.clip((relief.slope_rad - least_rad) / (most_rad - least_rad), 0, MAX_DEVIATION)
    total += np.float32(STEEPNESS) * (steepness - steepness.mean())
    return np.asarray(total / np.float32(max(float(total.std()), 1.0)), np.float32)


def _level(height_m: Field) -> Field:
    """Return heights without their mean slope, which would make edges of the stage stand out."""
    steps = np.arange(len(height_m)) - (len(height_m) - 1) / 2
    tilt_x = height_m.mean(axis=0) @ steps / (steps @ steps)
    tilt_y = height_m.mean(axis=1) @ steps / (steps @ steps)
    return np.asarray(height_m - tilt_x * steps - tilt_y * steps[:, None], np.float32)


def _smooth(values: Field, sigma_px: float) -> Field:
    """Return (M, M) values under a Gaussian; they go on mirrored beyond the edges.

    A cosine transform takes the same time for every size of the Gaussian.
    """
    size = len(values)
    cycles = np.arange(size) * (np.pi / size)
    kept = np.exp(-0.5 * (max(sigma_px, 1.0) * cycles) ** 2)
    waves = scipy.fft.dctn(values.astype(np.float64), norm="ortho")
    smooth = scipy.fft.idctn(waves * np.outer(kept, kept), norm="ortho")
    return np.asarray(smooth, np.float32)
