"""How the light of a cloudy sky divides: from the direction of the sun, and from all of it."""

from __future__ import annotations

from functools import lru_cache
from math import pi

import numpy as np

from oaisys_core.procedural.environment.clouds.dome import (
    COLUMNS,
    ROWS,
    cloud_elevations_rad,
    cloud_image,
)
from oaisys_core.procedural.environment.light import sky_irradiance_w_m2
from oaisys_core.scene.sky import Clouds, Sky
from oaisys_core.types import FloatArray

BROKEN, CLOSED = 0.6, 0.95
"""Cover up to which clouds are single, and from which on they are a layer."""


def spread_share(clouds: Clouds) -> float:
    """Return how much of what clouds scatter downwards comes from all of the sky.

    The rest counts as sunlight from the sun's direction: below broken clouds most of it comes from
    near the sun, and below a closed layer none does.
    """
    part = min(max((clouds.cover - BROKEN) / (CLOSED - BROKEN), 0.0), 1.0)
    return part * part * (3 - 2 * part)


@lru_cache(maxsize=2)
def daylight_factors(sky: Sky) -> tuple[float, float, float]:
    """Return the factors on the sky's radiance in red, green and blue, as a light on the ground."""
    clouds = sky.clouds
    # Without shadows the sun shines as if there were no clouds, and so does the sky.
    if clouds is None or not (clouds.shadows and sky.shows_clouds and spread_share(clouds)):
        return (1.0, 1.0, 1.0)
    clear_w_m2 = sky_irradiance_w_m2(sky)
    factors = below_clouds_w_m2(sky) / np.maximum(clear_w_m2, 1e-12)
    spread = 1 + spread_share(clouds) * (np.where(clear_w_m2 > 0, factors, 1.0) - 1)
    return (float(spread[0]), float(spread[1]), float(spread[2]))


def below_clouds_w_m2(sky: Sky) -> FloatArray:
    """Return the (3,) irradiance of level ground by a sky with its clouds, without the sun.

    It is the integral of the picture of clouds, before a sky that is as bright everywhere.
    """
    image = cloud_image(sky).astype(np.float64)
    elevations_rad = cloud_elevations_rad()
    steps_rad = np.diff(pi / 2 * (np.arange(ROWS + 1) / ROWS) ** 2)
    weights = np.sin(elevations_rad) * np.cos(elevations_rad) * steps_rad * (2 * pi / COLUMNS)
    found = np.einsum("r,rcv->v", weights, image)
    return np.asarray(found[:3] + sky_irradiance_w_m2(sky) * (found[3] / pi))
