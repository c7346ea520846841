"""Approximate light of sun, sky and distant ground, which the sky models do not provide.

Radiances are in Blender's scene units, matched to its sky models at a strength of 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import degrees, pi, radians, sin

import numpy as np

from oaisys_core.color import LUMINANCE
from oaisys_core.scene.lamps import Lamp
from oaisys_core.scene.sky import Color, Gradient, Haze, Hdri, Sky, gradient_radiance
from oaisys_core.types import FloatArray

PLAIN_ALBEDO = np.array((0.26, 0.22, 0.18))
"""Linear colour of the distant plain that lights objects from below the horizon."""

SKY_IRRADIANCE_W_M2 = 0.43
"""Approximate irradiance of a computed atmosphere on level ground, at a strength of 1 and a sun
elevation of 38 degrees.

Together with a sun of 4 W/m², 85 % of the light on level ground is direct, as under the clear sky
of Bird and Hulstrom (1981, A simplified clear sky model, SERI/TR-642-761).
"""

SKY_TINT = np.array((0.81, 1.01, 1.43))
"""Colour of this light, with a luminance of 1."""

HAZE_RADIANCE = np.array((0.36, 0.41, 0.43))
"""Radiance of the air above the horizon in white sunlight, close to that of the sky models."""

RAYLEIGH_OPTICAL_DEPTH = np.array((0.040, 0.097, 0.242))
"""Optical depth of the whole atmosphere towards the zenith at 680, 550 and 440 nm."""

DAYLIGHT = {
    -18: 6e-8,
    -12: 8e-7,
    -6: 3e-4,
    -3: 0.018,
    0: 0.125,
    2: 0.26,
    5: 0.43,
    9: 0.60,
    15: 0.76,
    20: 0.84,
    30: 0.95,
    38: 1.0,
    60: 1.08,
    80: 1.11,
}
"""Relative irradiance of a clear sky by the sun's elevation in degrees: that of Blender's
atmosphere down to -3 degrees, and after published illuminances below."""

SCALE_HEIGHT_M = 8400.0
"""Height over which the density of air falls to 1 / e."""

RINGS = 32
"""Rings of directions over which the radiance of a plain sky is summed up."""

LAMP_DISTANCE_M = 5.0
"""Distance from lamps at which their light is compared with that of the sky at night."""

MAX_GAIN = 8.0
"""Largest factor on a colour channel relative to the mean, for a light without that colour."""

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
    return _color(PLAIN_ALBEDO * level_irradiance_w_m2(sky) / pi)


def level_irradiance_w_m2(sky: Sky) -> FloatArray:
    """Return the (3,) irradiance of sun and sky together on level ground."""
    sun_w_m2 = sky.lamp_w_m2 * max(sin(sky.sun_elevation_rad), 0.0)
    return np.asarray(sun_w_m2 * np.array(sun_color(sky)) + sky_irradiance_w_m2(sky))


def sky_irradiance_w_m2(sky: Sky) -> FloatArray:
    """Return the (3,) irradiance of the sky, without the sun, on level ground."""
    if sky.hdri is not None:
        return _image_irradiance_w_m2(sky.hdri)
    if sky.model == "none":
        return np.zeros(3)
    if sky.model == "plain":
        of_gradient = gradient_irradiance_w_m2(sky.gradient, sky.sun_elevation_rad)
        return np.array(of_gradient) * sky.sky_strength
    brightness = sky.sky_strength * daylight(sky.sun_elevation_rad)
    return np.asarray(SKY_TINT * SKY_IRRADIANCE_W_M2 * brightness)


@lru_cache(maxsize=64)
def gradient_irradiance_w_m2(gradient: Gradient, sun_elevation_rad: float) -> Color:
    """Return the irradiance of a sky of plain colours, at a strength of 1, on level ground."""
    up = (np.arange(RINGS) + 0.5) / RINGS
    azimuth = 2 * pi * (np.arange(2 * RINGS) + 0.5) / (2 * RINGS)
    up, azimuth = (each.ravel() for each in np.meshgrid(up, azimuth))
    level = np.sqrt(1 - up**2)
    directions = np.stack((level * np.cos(azimuth), level * np.sin(azimuth), up), axis=-1)
    to_sun = np.array((np.cos(sun_elevation_rad), 0.0, np.sin(sun_elevation_rad)))
    radiance = gradient_radiance(gradient, directions, to_sun)
    # Each direction stands for the same solid angle.
    return _color(2 * pi * (radiance * up[:, None]).mean(axis=0))


def _image_irradiance_w_m2(hdri: Hdri) -> FloatArray:
    rows = len(hdri.image.radiance)
    up = np.sin(pi * (0.5 - (np.arange(rows // 2) + 0.5) / rows))
    mean = hdri.image.radiance[: rows // 2].mean(axis=1, dtype=np.float64)
    weight = (up * np.sqrt(1 - up**2))[:, None]
    # Integrates over the azimuth (2 pi) and over elevation in steps of pi / rows.
    return np.asarray(2 * pi**2 / rows * (mean * weight).sum(axis=0) * hdri.strength)


def white_gains(sky: Sky, lamps: Sequence[Lamp] = ()) -> Color:
    """Return factors on red, green and blue under which a grey card on level ground is grey.

    They do not change the card's luminance. Lamps count where no sun lamp shines, as if the
    card faced each of them at `LAMP_DISTANCE_M`.
    """
    illuminant = level_irradiance_w_m2(sky)
    if not sky.lamp_w_m2:
        for lamp in lamps:
            irradiance_w_m2 = lamp.strength_w / (4 * pi * LAMP_DISTANCE_M**2)
            illuminant = illuminant + irradiance_w_m2 * np.array(lamp.color)
    luminance = float(illuminant @ LUMINANCE)
    if luminance <= 0:
        return (1.0, 1.0, 1.0)
    gains = luminance / np.maximum(illuminant, luminance / MAX_GAIN)
    return _color(gains * luminance / (gains * illuminant @ LUMINANCE))


def horizon_radiance(sky: Sky) -> Color:
    """Return the radiance of the sky just above the horizon."""
    if sky.hdri is not None:
        return _band_radiance(sky.hdri)
    if sky.model == "none":
        return (0.0, 0.0, 0.0)
    if sky.model == "plain":
        return _color(np.array(sky.gradient.horizon) * sky.sky_strength)
    brightness = sky.sky_strength * daylight(sky.sun_elevation_rad)
    return _color(HAZE_RADIANCE * np.sqrt(sun_color(sky)) * brightness)


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


def daylight(sun_elevation_rad: float) -> float:
    """Return the brightness of a clear sky relative to a sun elevation of 38 degrees."""
    shares = np.log(list(DAYLIGHT.values()))
    return float(np.exp(np.interp(degrees(sun_elevation_rad), list(DAYLIGHT), shares)))


def _band_radiance(hdri: Hdri) -> Color:
    rows = len(hdri.image.radiance)
    band = max(round(rows * HORIZON_BAND_RAD / pi), 1)
    mean = hdri.image.radiance[rows // 2 - band : rows // 2].mean(axis=(0, 1), dtype=np.float64)
    return _color(mean * hdri.strength)


def _color(rgb: FloatArray) -> Color:
    red, green, blue = rgb.tolist()
    return (red, green, blue)
