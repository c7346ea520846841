"""Light of the sky and of the air, for rays that were cast."""

from __future__ import annotations

from math import pi

import numpy as np

from oaisys_core.environment.light import veil_radiance
from oaisys_core.sky import Haze, Sky, texels_at
from oaisys_core.types import FloatArray

LEAST_UP = 1e-4
"""Upward component of a ray at the horizon and below, for what has no end there."""

SKY_IRRADIANCE_W_M2 = 1.0
"""Irradiance of the whole sky on level ground, at a sky strength of 1."""


def sky_radiance(sky: Sky, directions: FloatArray) -> FloatArray:
    """Return the (N, 3) linear colour of the sky along (N, 3) directions in ``map``."""
    radiance = _clear_radiance(sky, directions)
    if sky.haze is None:
        return radiance
    up = directions[:, 2] / np.linalg.norm(directions, axis=1)
    distance_m = sky.haze.thickness_m / np.maximum(up, LEAST_UP)
    return in_haze(radiance, distance_m, sky.haze, sky)


def _clear_radiance(sky: Sky, directions: FloatArray) -> FloatArray:
    if sky.hdri is not None:
        pixels = sky.hdri.image.radiance
        rows, cols = texels_at(directions, sky.hdri.rotation_rad, pixels.shape)
        return np.asarray(pixels[rows, cols] * sky.hdri.strength, dtype=np.float64)
    if sky.model == "none":
        return np.zeros_like(directions)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    share = np.sqrt(np.maximum(unit[:, 2], 0.0))[:, None]
    gradient = sky.gradient
    color = np.array(gradient.horizon) * (1 - share) + np.array(gradient.zenith) * share
    angle = np.arccos(np.clip(unit @ np.array(sky.to_sun), -1.0, 1.0))
    glow = np.exp(-angle / gradient.glow_rad)[:, None] * np.array(gradient.glow)
    return np.asarray(sky.sky_strength * (color + glow))


def sky_irradiance_w_m2(sky: Sky) -> float:
    """Return the irradiance of the whole sky on level ground."""
    if sky.hdri is not None:
        rows = len(sky.hdri.image.radiance)
        up = np.sin(pi * (0.5 - (np.arange(rows // 2) + 0.5) / rows))
        mean = sky.hdri.image.radiance[: rows // 2].mean(axis=(1, 2), dtype=np.float64)
        cos_elevation = np.sqrt(1 - up**2)
        # Over azimuth 2 pi, over elevation in steps of pi / rows.
        return float(2 * pi**2 / rows * (mean * up * cos_elevation).sum() * sky.hdri.strength)
    return SKY_IRRADIANCE_W_M2 * sky.sky_strength * (sky.model != "none")


def in_haze(radiance: FloatArray, distance_m: FloatArray, haze: Haze, sky: Sky) -> FloatArray:
    """Return what is left of (N, 3) colours at a distance, and the air's own (Koschmieder)."""
    veil = np.array(veil_radiance(sky, haze))
    clear = np.exp(-distance_m[:, None] * np.array(haze.extinction_per_m))
    return np.asarray(radiance * clear + veil * (1 - clear))
