"""The radiance of a clear sky: sunlight that air and dust have scattered once.

It follows T. Nishita, T. Sirai, K. Tadamura and E. Nakamae, "Display of the Earth Taking into
Account Atmospheric Scattering" (SIGGRAPH 1993), as Blender's sky does, for three colours instead of
a spectrum, and is scaled to the brightness that `light` states.
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, pi, radians, sin

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import LUMINANCE
from oaisys_core.procedural.environment.light import (
    SKY_IRRADIANCE_W_M2,
    SKY_TINT,
)
from oaisys_core.types import FloatArray

BODY_M, TOP_M = 6.36e6, 6.42e6
"""Radius of the ground, and of the top of the atmosphere."""

AIR_HEIGHT_M, DUST_HEIGHT_M = 8000.0, 1200.0
"""Heights over which the densities fall to 1 / e."""

AIR_PER_M = np.array((5.8e-6, 13.0e-6, 30.0e-6))
"""Scattering of air at sea level, for red, green and blue."""

DUST_PER_M, DUST_FORWARD = 2.0e-5, 0.76
"""Scattering of dust at sea level, and the mean cosine of its angle."""

DUST_LOSS = 1.11
"""Extinction by dust in units of its scattering."""

OZONE_PER_M = np.array((1.6e-6, 1.9e-6, 0.1e-6))
OZONE_AT_M, OZONE_WIDTH_M = 25_000.0, 15_000.0
"""Absorption of ozone where there is most, that height, and half its layer's thickness."""

STEPS, SUN_STEPS = 32, 12
"""Steps along the ray, and from each towards the sun."""

ROWS, COLUMNS = 64, 65
"""Directions: elevations from the horizon up, azimuths from the sun's to the opposite."""

HORIZON_LOSS, HORIZON_RAD = np.array((0.16, 0.30, 0.60)), radians(3.5)
"""By how much three colours are too bright at the horizon beside a spectrum, whose short waves get
lost on the long way, and the elevation at which that has fallen to 1 / e."""

REFERENCE_RAD = radians(38.0)
"""Sun elevation at which `SKY_IRRADIANCE_W_M2` is stated."""


@lru_cache(maxsize=8)
def clear_sky(
    sun_elevation_rad: float, altitude_m: float, air: float, dust: float, ozone: float
) -> NDArray[np.float32]:
    """Return the (ROWS, COLUMNS, 3) radiance of the sky, at a strength of 1.

    Row i looks up by pi / 2 * (i / (ROWS - 1))² radians; column j is at an azimuth of
    pi * j / (COLUMNS - 1) from the sun.
    """
    found = _scattered(sun_elevation_rad, altitude_m, air, dust, ozone) * _scale()
    near = np.exp(-elevations_rad() / HORIZON_RAD)[:, None, None]
    return np.asarray(found / (1 + near * HORIZON_LOSS), np.float32)


def elevations_rad() -> FloatArray:
    """Return the (ROWS,) elevations of the rows of `clear_sky`."""
    return np.asarray(pi / 2 * (np.arange(ROWS) / (ROWS - 1)) ** 2)


def level_irradiance(radiance: NDArray[np.float32]) -> FloatArray:
    """Return the (3,) irradiance on level ground of radiances like those of `clear_sky`."""
    up_rad = elevations_rad()
    of_rows = radiance.astype(np.float64)
    means = (of_rows[:, 1:] + of_rows[:, :-1]).mean(axis=1) / 2
    weights = (np.sin(up_rad) * np.cos(up_rad))[:, None]
    values, widths = means * weights, np.diff(up_rad)[:, None]
    return np.asarray(pi * ((values[1:] + values[:-1]) * widths).sum(axis=0))


@lru_cache(maxsize=1)
def _scale() -> FloatArray:
    """Return factors by which the sky has the stated brightness and colour."""
    found = level_irradiance(_scattered(REFERENCE_RAD, 0.0, 1.0, 1.0, 1.0))
    tint = SKY_TINT / (SKY_TINT @ LUMINANCE)
    return np.asarray(SKY_IRRADIANCE_W_M2 * tint / found)


def _scattered(
    sun_elevation_rad: float, altitude_m: float, air: float, dust: float, ozone: float
) -> NDArray[np.float32]:
    up_rad = elevations_rad()[:, None]
    azimuth_rad = np.linspace(0, pi, COLUMNS)[None]
    rays = np.stack(
        np.broadcast_arrays(
            np.cos(up_rad) * np.cos(azimuth_rad),
            np.cos(up_rad) * np.sin(azimuth_rad),
            np.sin(up_rad),
        ),
        axis=-1,
    )
    to_sun = np.array((cos(sun_elevation_rad), 0.0, sin(sun_elevation_rad)))
    eye_m = BODY_M + min(max(altitude_m, 1.0), 0.99 * (TOP_M - BODY_M))
    densities = np.array((air, dust, ozone))
    # All of a row's rays leave the atmosphere after the same way.
    length_m = _to_top_m(eye_m, rays[:, 0, 2])
    step_m = length_m / STEPS
    total = np.zeros((ROWS, COLUMNS, 3))
    depth = np.zeros((ROWS, 1, 3))
    scattering = _phases(rays @ to_sun)
    for step in range(STEPS):
        at_m = rays * ((step + 0.5) * step_m)[:, None, None]
        at_m[..., 2] += eye_m
        radius_m = np.linalg.norm(at_m, axis=-1)
        here = _densities(radius_m[:, :1] - BODY_M) * densities
        passed = _extinction(here) * step_m[:, None, None]
        sun_depth, is_lit = _towards_sun(at_m, radius_m, to_sun, densities)
        light = np.exp(-(depth + passed / 2 + sun_depth)) * is_lit[..., None]
        of_air = here[..., :1] * AIR_PER_M * scattering[0][..., None]
        of_dust = here[..., 1:2] * DUST_PER_M * scattering[1][..., None]
        total += light * (of_air + of_dust) * step_m[:, None, None]
        depth = depth + passed
    return total.astype(np.float32)


def _towards_sun(
    at_m: FloatArray, radius_m: FloatArray, to_sun: FloatArray, densities: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the optical depth between points and the sun, and whether they see it."""
    up = (at_m @ to_sun) / radius_m
    is_lit = (up > 0) | (radius_m * np.sqrt(np.maximum(1 - up * up, 0)) > BODY_M)
    step_m = _to_top_m(radius_m, up) / SUN_STEPS
    depth = np.zeros((*radius_m.shape, 3))
    for step in range(SUN_STEPS):
        way_m = (step + 0.5) * step_m
        height_m = np.sqrt(radius_m**2 + way_m**2 + 2 * radius_m * way_m * up) - BODY_M
        depth += _extinction(_densities(height_m) * densities) * step_m[..., None]
    return depth, is_lit


def _to_top_m(radius_m: FloatArray | float, up: FloatArray) -> FloatArray:
    """Return the way to the top of the atmosphere along rays whose vertical component is ``up``."""
    rise_m = radius_m * up
    return np.asarray(np.sqrt(rise_m**2 + TOP_M**2 - np.square(radius_m)) - rise_m)


def _densities(height_m: FloatArray) -> FloatArray:
    """Return the (..., 3) densities of air, dust and ozone relative to their largest."""
    height_m = np.maximum(height_m, 0.0)
    ozone = np.maximum(1 - np.abs(height_m - OZONE_AT_M) / OZONE_WIDTH_M, 0.0)
    return np.stack(
        (np.exp(-height_m / AIR_HEIGHT_M), np.exp(-height_m / DUST_HEIGHT_M), ozone), axis=-1
    )


def _extinction(densities: FloatArray) -> FloatArray:
    """Return the (..., 3) extinction by colour of (..., 3) densities."""
    per_m = np.stack((AIR_PER_M, np.full(3, DUST_PER_M * DUST_LOSS), OZONE_PER_M))
    return np.asarray(densities @ per_m)


def _phases(cosines: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the shares of light that air and dust scatter by an angle, per steradian."""
    square = cosines * cosines
    g = DUST_FORWARD
    of_air = 3 / (16 * pi) * (1 + square)
    of_dust = 3 * (1 - g * g) * (1 + square)
    of_dust /= 8 * pi * (2 + g * g) * (1 + g * g - 2 * g * cosines) ** 1.5
    return of_air, of_dust
