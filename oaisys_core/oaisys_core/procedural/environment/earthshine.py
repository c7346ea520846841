"""Sunlight that Earth throws on the Moon.

Earth counts as a sphere of Lambert's law, with the phase function of Russell (1916), Astrophysical
Journal 43, 173. Its albedo is that of such a sphere which is as bright as Earth, the mean of Goode
et al. (2001), Geophysical Research Letters 28, 1671: 0.297. Clouds and continents change it by
some 15 % within a day, and near the new and the full Earth it is brighter than such a sphere.
"""

from __future__ import annotations

from datetime import datetime
from math import acos, cos, pi, sin

import numpy as np

from oaisys_core.procedural.environment.sun_in_map import SeenBody, sight_over
from oaisys_core.scene import Lamp
from oaisys_core.types import FloatArray

ALBEDO = 0.297
DISTANCE_M = 1e6
"""Of the lamp that stands for Earth: 10 km from the origin its light differs by 2 %."""
NAME = "earthshine"


def earthshine_lamp(axes: FloatArray, when: datetime, sun_w_m2: float) -> Lamp | None:
    """Return the lamp that lights the Moon as Earth does; None while Earth is below the horizon.

    Args:
        axes: (3, 3) rows x, y and up of ``map`` in the Moon's own axes.
        when: Date and time with its offset from UTC.
        sun_w_m2: Irradiance of the sun across its beam at the place.
    """
    earth, sun = (sight_over(axes, "moon", target, when) for target in ("earth", "sun"))
    radius_rad = earth.angular_diameter_rad / 2
    if earth.elevation_rad <= -radius_rad:
        return None
    to_earth, to_sun = _direction(earth) * earth.distance_au, _direction(sun) * sun.distance_au
    earth_to_sun = to_sun - to_earth
    distance_au = float(np.linalg.norm(earth_to_sun))
    phase_rad = acos(float(earth_to_sun @ -to_earth) / distance_au / earth.distance_au)
    at_earth_w_m2 = sun_w_m2 * (sun.distance_au / distance_au) ** 2
    share = 2 / 3 * ALBEDO * lambert_phase(phase_rad) * sin(radius_rad) ** 2
    x, y, z = (_direction(earth) * DISTANCE_M).tolist()
    return Lamp(
        name=NAME,
        kind="point",
        frame="map",
        position_m=(x, y, z),
        forward=(0.0, 0.0, -1.0),
        right=(1.0, 0.0, 0.0),
        strength_w=4 * pi * DISTANCE_M**2 * at_earth_w_m2 * share,
        color=(1.0, 1.0, 1.0),
        radius_m=DISTANCE_M * sin(radius_rad),
    )


def lambert_phase(phase_rad: float) -> float:
    """Return the brightness of a sphere of Lambert's law relative to that at a phase angle of 0."""
    return (sin(phase_rad) + (pi - phase_rad) * cos(phase_rad)) / pi


def _direction(seen: SeenBody) -> FloatArray:
    level = cos(seen.elevation_rad)
    return np.array(
        (level * cos(seen.azimuth_rad), level * sin(seen.azimuth_rad), sin(seen.elevation_rad))
    )
