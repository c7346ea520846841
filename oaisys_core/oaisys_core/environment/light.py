"""Colours of sun, horizon and far ground, for what no sky model tells.

All are in the units of Blender's scenes, and set by its sky models at a strength of 1.
"""

from __future__ import annotations

from math import degrees, pi, radians, sin

import numpy as np

from oaisys_core.sky import Color, Haze, Hdri, Sky
from oaisys_core.types import FloatArray

PLAIN_ALBEDO = np.array((0.26, 0.22, 0.18))
"""Linear colour of the far plain that lights things from below the horizon."""

SKY_IRRADIANCE_W_M2 = 0.65
"""Of the sky on level ground at a strength of 1, roughly: it only lights the far plain."""

HAZE_RADIANCE = np.array((0.55, 0.62, 0.65))
"""Of the air above the horizon, before the sun's colour; near what the sky models give there."""

RAYLEIGH_OPTICAL_DEPTH = np.array((0.040, 0.097, 0.242))
"""Of the whole atmosphere towards the zenith at 680, 550 and 440 nm."""

DAYLIGHT_DEG = (-18.0, -12.0, -6.0, -3.0, 0.0, 4.0, 10.0, 20.0, 38.0)
DAYLIGHT_SHARES = (6e-8, 8e-7, 3e-4, 5e-3, 0.045, 0.25, 0.5, 0.8, 1.0)
"""Brightness of a clear sky by the sun's elevation, roughly as its illuminance is published."""

SCALE_HEIGHT_M = 8400.0
"""Height over which air becomes thinner by 1 / e."""

HORIZON_BAND_RAD = radians(6.0)
"""Height of the band of an image's sky that haze takes its colour from."""


def sun_color(sky: Sky) -> Color:
    """Return the colour of direct sunlight: white less what the air scatters out of its path.

    Air mass by Kasten and Young (1989). A sky that is not computed from air leaves it white.
    """
    if sky.model != "atmosphere":
        return (1.0, 1.0, 1.0)
    elevation_deg = max(degrees(sky.sun_elevation_rad), 0.0)
    slant = sin(radians(elevation_deg)) + 0.50572 * (elevation_deg + 6.07995) ** -1.6364
    air = sky.air * np.exp(-sky.altitude_m / SCALE_HEIGHT_M) / slant
    red, green, blue = np.exp(-RAYLEIGH_OPTICAL_DEPTH * air)
    return (1.0, float(green / red), float(blue / red))


def plain_radiance(sky: Sky) -> Color:
    """Return the radiance of a dull level plain under sun and sky (Lambert)."""
    sun_w_m2 = sky.lamp_w_m2 * max(sin(sky.sun_elevation_rad), 0.0)
    sky_w_m2 = 0.0
    if sky.model != "none":
        sky_w_m2 = SKY_IRRADIANCE_W_M2 * sky.sky_strength * _daylight(sky)
    return _color(PLAIN_ALBEDO * (sun_w_m2 * np.array(sun_color(sky)) + sky_w_m2) / pi)


def horizon_radiance(sky: Sky) -> Color:
    """Return the colour that what is far fades into: that of the sky just above the horizon."""
    if sky.hdri is not None:
        return _band_radiance(sky.hdri)
    if sky.model == "none":
        return (0.0, 0.0, 0.0)
    if sky.model == "plain":
        return _color(np.array(sky.gradient.horizon) * sky.sky_strength)
    return _color(HAZE_RADIANCE * np.sqrt(sun_color(sky)) * sky.sky_strength * _daylight(sky))


def veil_radiance(sky: Sky, haze: Haze) -> Color:
    """Return the radiance of an infinite depth of haze.

    Its light comes from the sun, the sky and the ground together, and is near white.
    """
    if haze.veil is not None:
        return haze.veil
    horizon = np.array(horizon_radiance(sky))
    if sky.hdri is None and sky.model == "atmosphere":
        horizon = horizon / HAZE_RADIANCE * HAZE_RADIANCE.mean()
    return _color(horizon * np.array(haze.tint))


def _daylight(sky: Sky) -> float:
    """Return how bright the sky is, as a share of that on a day with the sun at 38 degrees."""
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
