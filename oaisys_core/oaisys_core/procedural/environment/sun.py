"""The position of the sun as seen from a place on Earth.

After Meeus, Astronomical Algorithms (1998), chapters 12, 22 and 25 in their shorter form, which
are accurate to about 0.01 degrees for centuries around 2000. The difference between dynamical and
universal time (about a minute) changes the result by less than 0.001 degrees and is ignored.
"""

from __future__ import annotations

from datetime import datetime, timezone
from math import asin, atan2, cos, degrees, radians, sin, tan
from typing import NamedTuple

J2000 = datetime(2000, 1, 1, 12, tzinfo=timezone.utc)  # noqa: UP017 - as in Python 3.10
DAYS_PER_CENTURY = 36525.0
PARALLAX_RAD = radians(8.794 / 3600)
"""Parallax of the sun at the horizon."""


class SunPosition(NamedTuple):
    """The apparent position of the sun.

    Attributes:
        elevation_rad: Elevation above the horizon, including refraction in standard air.
        azimuth_rad: Azimuth clockwise from true north, 0 to 2π.
    """

    elevation_rad: float
    azimuth_rad: float


def sun_position(when: datetime, latitude_deg: float, longitude_deg: float) -> SunPosition:
    """Return the apparent position of the sun.

    Args:
        when: Date and time with its offset from UTC.
        latitude_deg: North is positive.
        longitude_deg: East is positive.

    Raises:
        ValueError: The time has no offset from UTC.
    """
    if when.tzinfo is None:
        raise ValueError(f"received {when}, expected a time with its offset from UTC")
    days = (when - J2000).total_seconds() / 86400
    right_ascension, declination = _equatorial(days / DAYS_PER_CENTURY)
    sidereal_deg = 280.46061837 + 360.98564736629 * days
    hour_angle = radians(sidereal_deg + longitude_deg) - right_ascension
    latitude = radians(latitude_deg)
    true_elevation = asin(
        sin(latitude) * sin(declination) + cos(latitude) * cos(declination) * cos(hour_angle)
    )
    azimuth_from_south = atan2(
        sin(hour_angle), cos(hour_angle) * sin(latitude) - tan(declination) * cos(latitude)
    )
    seen = true_elevation - PARALLAX_RAD * cos(true_elevation)
    return SunPosition(seen + _refraction(seen), (azimuth_from_south + radians(180)) % radians(360))


def azimuth_in_map(azimuth_rad: float, north_offset_rad: float) -> float:
    """Return the azimuth in ``map``, counter-clockwise from +x, of a compass azimuth.

    Args:
        azimuth_rad: Clockwise from true north.
        north_offset_rad: Direction of true north, counter-clockwise from +y.
    """
    return radians(90) + north_offset_rad - azimuth_rad


def _equatorial(centuries: float) -> tuple[float, float]:
    """Return the apparent right ascension and declination, in radians, centuries after J2000."""
    t = centuries
    mean_longitude = 280.46646 + t * (36000.76983 + t * 0.0003032)
    anomaly = radians(357.52911 + t * (35999.05029 - t * 0.0001537))
    centre = (
        (1.914602 - t * (0.004817 + t * 0.000014)) * sin(anomaly)
        + (0.019993 - t * 0.000101) * sin(2 * anomaly)
        + 0.000289 * sin(3 * anomaly)
    )
    node = radians(125.04 - 1934.136 * t)
    longitude = radians(mean_longitude + centre - 0.00569 - 0.00478 * sin(node))
    obliquity = radians(
        23.4392911 - t * (0.0130042 + t * (1.64e-7 - t * 5.04e-7)) + 0.00256 * cos(node)
    )
    return (
        atan2(cos(obliquity) * sin(longitude), cos(longitude)),
        asin(sin(obliquity) * sin(longitude)),
    )


def _refraction(elevation_rad: float) -> float:
    """Return the refraction in standard air at a true elevation (Sæmundsson 1986)."""
    elevation_deg = degrees(elevation_rad)
    if elevation_deg < -1.0:
        return 0.0
    minutes = 1.02 / tan(radians(elevation_deg + 10.3 / (elevation_deg + 5.11)))
    return radians(max(minutes, 0.0) / 60)
