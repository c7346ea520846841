"""Where the sun, or Earth, stands over a place on Earth, the Moon or Mars at a time."""

from __future__ import annotations

from datetime import datetime
from math import asin, atan2, cos, degrees, radians, sin
from typing import NamedTuple

import numpy as np

from oaisys_core.config.sections.stage import Body, body_name
from oaisys_core.config.sections.sun import SunFromTimeConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import places
from oaisys_core.procedural.environment.ephemeris import Target, vector_km
from oaisys_core.procedural.environment.sun import AU_KM, refraction_rad, sun_from_earth_km
from oaisys_core.types import FloatArray, Georeference

SUN_RADIUS_KM = 695_700.0
"""Nominal radius of the sun (IAU 2015, resolution B3)."""

EARTH_RADIUS_KM = 6378.1366
"""Radius of Earth's equator (IAU 2009), by which Earth's disc is measured."""

MEAN_AU = {"earth": 1.0, "moon": 1.0, "mars": 1.52366}
"""Mean distances from the sun: semi-major axes of orbits (NASA's planetary fact sheets)."""

RADIUS_KM = {"earth": 6371.0, "moon": 1737.4, "mars": 3389.5}
"""Distance of places from their body's centre."""


class SeenBody(NamedTuple):
    """A body in the sky of a place.

    Attributes:
        elevation_rad: Of its centre above the horizon; on Earth with refraction in standard air.
        azimuth_rad: In ``map``, counter-clockwise from +x.
        distance_au: Its distance.
        angular_diameter_rad: Its angular diameter.
    """

    elevation_rad: float
    azimuth_rad: float
    distance_au: float
    angular_diameter_rad: float


def mean_sun_distance_au(body: Body) -> float:
    """Return the mean distance of a body from the sun; 1 au for a body that is not known."""
    return MEAN_AU.get(body_name(body) or "", 1.0)


def sun_diameter_rad(distance_au: float) -> float:
    """Return the angular diameter of the sun."""
    return 2 * asin(SUN_RADIUS_KM / (distance_au * AU_KM))


def sun_at(
    config: SunFromTimeConfig, when: datetime, body: Body, georeference: Georeference | None
) -> SeenBody:
    """Return the sun over the place that a configuration names, or over the origin of ``map``.

    Args:
        config: Place and true north, if it has them.
        when: Date and time with its offset from UTC.
        body: Earth, the Moon or Mars, by name or radius.
        georeference: Of the ground; None if it is of no place.

    Raises:
        InvalidInputError: The body is another, there is no place, or no ephemeris.
    """
    axes = map_axes(config, georeference, body)
    return sight_over(axes, body, "sun", when)


def sight_over(axes: FloatArray, body: Body, target: Target, when: datetime) -> SeenBody:
    """Return a target as it is seen over a place.

    Args:
        axes: (3, 3) rows x, y and up of ``map`` in the body's own axes.
        body: The body that one stands on.
        target: The sun, or from other bodies Earth.
        when: Date and time with its offset from UTC.
    """
    name = body_name(body)
    if name not in ("earth", "moon", "mars"):
        expected = "null on a body that is not Earth, the Moon or Mars (stage.body)"
        raise InvalidInputError("environment.sun_from_time", "a time", expected)
    if name == "earth":
        from_centre_km = sun_from_earth_km(when)
    else:
        from_centre_km = vector_km("moon" if name == "moon" else "mars", target, when)
    from_place_km = axes @ from_centre_km - (0.0, 0.0, RADIUS_KM[name])
    distance_km = float(np.linalg.norm(from_place_km))
    x, y, z = (from_place_km / distance_km).tolist()
    elevation_rad = asin(min(max(z, -1.0), 1.0))  # rounded, it may be beyond 1
    if name == "earth":
        elevation_rad += refraction_rad(elevation_rad)
    radius_km = SUN_RADIUS_KM if target == "sun" else EARTH_RADIUS_KM
    diameter_rad = 2 * asin(radius_km / distance_km)
    return SeenBody(elevation_rad, atan2(y, x), distance_km / AU_KM, diameter_rad)


def map_axes(
    config: SunFromTimeConfig, georeference: Georeference | None, body: Body
) -> FloatArray:
    """Return the (3, 3) rows x, y and up of ``map`` in the body's own axes.

    Raises:
        InvalidInputError: Neither the configuration nor the ground names a place.
    """
    if config.latitude_deg is not None and config.longitude_deg is not None:
        north_deg = config.north_offset_deg
        if north_deg is None:
            north_deg = 0.0 if georeference is None else places.north_deg(georeference)
        return axes_of_place(config.longitude_deg, config.latitude_deg, north_deg)
    if georeference is None:
        expected = (
            "a number, because the stage has no elevation model that says where it lies"
            " (see `oaisys place info`)"
        )
        raise InvalidInputError("environment.sun_from_time.latitude_deg", None, expected)
    axes = places.axes_on_body(georeference, flattening_of(body))
    if config.north_offset_deg is None:
        return axes
    return turn_to_north(axes, config.north_offset_deg)


def flattening_of(body: Body) -> float:
    """Return the flattening of a body, for maps on a sphere: their latitudes are from its centre.

    That of Mars is 1/169.894 (Archinal et al. 2018); on Earth such maps are none of precision.
    """
    return 1 / 169.8944472 if body_name(body) == "mars" else 0.0


def axes_of_place(longitude_deg: float, latitude_deg: float, north_deg: float) -> FloatArray:
    """Return the (3, 3) rows x, y and up, with true north ``north_deg`` from +y, anti-clockwise."""
    longitude, latitude = radians(longitude_deg), radians(latitude_deg)
    east = np.array((-sin(longitude), cos(longitude), 0.0))
    up = np.array((cos(latitude) * cos(longitude), cos(latitude) * sin(longitude), sin(latitude)))
    return _turned(east, np.cross(up, east), up, north_deg)


def turn_to_north(axes: FloatArray, north_deg: float) -> FloatArray:
    """Return axes around the same vertical whose true north is ``north_deg`` from +y."""
    up = axes[2]
    longitude_deg = degrees(atan2(up[1], up[0]))
    latitude_deg = degrees(asin(min(max(up[2], -1.0), 1.0)))
    return axes_of_place(longitude_deg, latitude_deg, north_deg)


def _turned(east: FloatArray, north: FloatArray, up: FloatArray, north_deg: float) -> FloatArray:
    c, s = cos(radians(north_deg)), sin(radians(north_deg))
    return np.stack((c * east - s * north, s * east + c * north, up))
