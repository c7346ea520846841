"""Approximate colours of sun, horizon and distant ground, which the sky models do not provide.

Radiances are in Blender's scene units, matched to its sky models at a strength of 1.
"""

from __future__ import annotations

from math import degrees, pi, radians, sin

import numpy as np

from oaisys_core.sky import Color, Haze, Hdri, Sky
from oaisys_core.types import FloatArray

PLAIN_ALBEDO = np.array((0.26, 0.22, 0.18))
"""Linear colour of the distant plain that lights objects from below the horizon."""

SKY_IRRADIANCE_W_M2 = 0.65
"""Approximate irradiance of the sky on level ground at a strength of 1."""

HAZE_RADIANCE = np.array((0.55, 0.62, 0.65))
"""Radiance of the air above the horizon in white sunlight, close to that of the sky models."""

RAYLEIGH_OPTICAL_DEPTH = np.array((0.040, 0.097, 0.242))
"""Optical depth of the whole atmosphere towards the zenith at 680, 550 and 440 nm."""

DAYLIGHT_DEG = (-18.0, -12.0, -6.0, -3.0, 0.0, 4.0, 10.0, 20.0, 38.0)
DAYLIGHT_SHARES = (6e-8, 8e-7, 3e-4, 5e-3, 0.045, 0.25, 0.5, 0.8, 1.0)
"""Relative brightness of a clear sky by the sun's elevation, after published illuminances."""

SCALE_HEIGHT_M = 8400.0
"""Height over which the density of air falls to 1 / e."""

HORIZON_BAND_RAD = radians(6.0)
"""Height of the band above the horizon of a sky image from which haze takes its colour."""


def sun_color(sky: Sky) -> Color:
    """Return the colour of direct sunlight: white minus the light that air scatters.

    Air mass after Kasten and Young (1989). Without a computed atmosphere it is white.
    """
    if sky.model != "atmosphere":
        return (1.0, 1.0, 1.0)
    elevation_deg = max(degrees(sky.sun_elevation_rad), 0.0)
    slant = sin(radians(elevation_deg)) + 0.50572 * (elevation_deg + 6.07995) ** -1.6364
    air = sky.air * np.exp(-sky.altitude_m / SCALE_HEIGHT_M) / slant
    red, green, blue = np.exp(-RAYLEIGH_OPTICAL_DEPTH * air)
    return (1.0, float(green / red), float(blue / red))


def plain_radiance(sky: Sky) -> Color:
    """Return the radiance of a level Lambertian plain under sun and sky."""
    sun_w_m2 = sky.lamp_w_m2 * max(sin(sky.sun_elevation_rad), 0.0)
    sky_w_m2 = 0.0
    if sky.model != "none":
        sky_w_m2 = SKY_IRRADIANCE_W_M2 * sky.sky_strength * _daylight(sky)
    return _color(PLAIN_ALBEDO * (sun_w_m2 * np.array(sun_color(sky)) + sky_w_m2) / pi)


def horizon_radiance(sky: Sky) -> Color:
    """Return the radiance of the sky just above the horizon."""
    if sky.hdri is not None:
        return _band_radiance(sky.hdri)
    if sky.model == "none":
        return (0.0, 0.0, 0.0)
    if sky.model == "plain":
        return _color(np.array(sky.gradient.horizon) * sky.sky_strength)
    return _color(HAZE_RADIANCE * np.sqrt(sun_color(sky)) * sky.sky_strength * _daylight(sky))


def veil_radiance(sky: Sky, haze: Haze) -> Color:
    """Return the radiance of an infinite depth of haze.

    It is lit by sun, sky and ground together, so its colour is close to white.
    """
    if haze.veil is not None:
        return haze.veil
    horizon = np.array(horizon_radiance(sky))
    if sky.hdri is None and sky.model == "atmosphere":
        horizon = horizon / HAZE_RADIANCE * HAZE_RADIANCE.mean()
    return _color(horizon * np.array(haze.tint))


def _daylight(sky: Sky) -> float:
    """Return the brightness of the sky relative to a sun elevation of 38 degrees."""
    if sky.model != "atmosphere":
        return 1.0
    shares = np.log(DAYLIGHT_SHARES)
    return float(np.exp(np.interp(degrees(sky.sun_elevation_rad), DAYLIGHT_DEG, shares)))


def _band_radiance(hdri: Hdri) -> Color:
    rows = len(hdri.image.radiance)
    band = max(round(rows * HORIZON_BAND_RAD / pi), 1)
    mean = hdri.image.radiance[rows // 2 - band : rows // 2].mean(axis=(0, 1), dtype=np.float64)
    return _color(mean * hdri.strength)


def _color(rgb: FloatArray) -> Color:
    red, green, blue = rgb.tolist()
    return (red, green, blue)
