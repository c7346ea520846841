"""The apparent position of the sun as seen from Earth, and refraction in its air.

After Meeus, Astronomical Algorithms (1998), chapters 12, 22 and 25 in their shorter form, which
are accurate to about 0.01 degrees for centuries around 2000. The difference between dynamical and
universal time (about a minute) changes the result by less than 0.001 degrees and is ignored.
"""

from __future__ import annotations

from datetime import datetime, timezone
from math import asin, atan2, cos, degrees, radians, sin, tan

import numpy as np

from oaisys_core.types import FloatArray

AU_KM = 149_597_870.7
"""Astronomical unit (IAU 2012, resolution B2)."""

J2000 = datetime(2000, 1, 1, 12, tzinfo=timezone.utc)  # noqa: UP017 - as in Python 3.10
DAYS_PER_CENTURY = 36525.0


def sun_from_earth_km(when: datetime) -> FloatArray:
    """Return the (3,) apparent position of the sun from Earth's centre, in Earth's own axes.

    These are x to longitude 0 on the equator, z to the north pole.

    Args:
        when: Date and time with its offset from UTC.

    Raises:
        ValueError: The time has no offset from UTC.
    """
    if when.tzinfo is None:
        raise ValueError(f"received {when}, expected a time with its offset from UTC")
    days = (when - J2000).total_seconds() / 86400
    right_ascension, declination, distance_au = _equatorial(days / DAYS_PER_CENTURY)
    longitude = right_ascension - radians(280.46061837 + 360.98564736629 * days)
    direction = (
        cos(declination) * cos(longitude),
        cos(declination) * sin(longitude),
        sin(declination),
    )
    return distance_au * AU_KM * np.array(direction)


def _equatorial(centuries: float) -> tuple[float, float, float]:
    """Return the apparent right ascension and declination, in radians, and the distance in au."""
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
    eccentricity = 0.016708634 - t * (0.000042037 + t * 0.0000001267)
    from_perihelion = anomaly + radians(centre)
    distance_au = 1.000001018 * (1 - eccentricity**2) / (1 + eccentricity * cos(from_perihelion))
    return (
        atan2(cos(obliquity) * sin(longitude), cos(longitude)),
        asin(sin(obliquity) * sin(longitude)),
        distance_au,
    )


def refraction_rad(elevation_rad: float) -> float:
    """Return the refraction in standard air at a true elevation (Sæmundsson 1986)."""
    elevation_deg = degrees(elevation_rad)
    if elevation_deg < -1.0:
        return 0.0
    minutes = 1.02 / tan(radians(elevation_deg + 10.3 / (elevation_deg + 5.11)))
    return radians(max(minutes, 0.0) / 60)
