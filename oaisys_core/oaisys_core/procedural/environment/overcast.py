"""The overcast sky of the CIE, and how bright it is."""

from __future__ import annotations

from math import sin

from oaisys_core.scene.sky import Color, Gradient

TINT: Color = (0.96, 1.0, 1.06)
"""Colour of thick clouds by day, a little cooler than sunlight."""

OVERCAST = Gradient(
    zenith=TINT,
    horizon=(TINT[0] / 3, TINT[1] / 3, TINT[2] / 3),
    power=1.0,
)
"""Three times as bright at the zenith as at the horizon: (1 + 2 sin e) / 3 at the elevation e (Moon
and Spencer, "Illumination from a non-uniform sky", Illuminating Engineering 37, 1942; type 16 of
CIE S 011/ISO 15469)."""

SOLAR_KLX = 133.3
"""Illuminance of a surface that faces the sun above the air."""


def overcast_share(sun_elevation_rad: float) -> float:
    """Return the light on level ground as a share of sunlight above the air, by day.

    It is 0.3 + 21 sin(elevation) kilolux (Krochmann and Seidl, "Quantitative data on daylight for
    illuminating engineering", Lighting Research and Technology 6(3), 1974).
    """
    return (0.3 + 21.0 * max(sin(sun_elevation_rad), 0.0)) / SOLAR_KLX
