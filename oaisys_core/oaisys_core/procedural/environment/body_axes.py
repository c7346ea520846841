"""The orientation of the Moon and Mars in space, by the formulas of the IAU's working group.

Archinal et al. (2018), Report of the IAU Working Group on Cartographic Coordinates and Rotational
Elements: 2015; that of the Moon is an approximation of its mean Earth/polar axis system within
0.005 degrees. Each element is a polynomial plus a series of sines (of the pole's declination:
cosines), in degrees; t is in Julian centuries and d in days of barycentric dynamical time since
J2000.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy

from oaisys_core.types import FloatArray

DAYS_PER_CENTURY = 36525.0

MOON_ANGLES = np.array(
    (
        (125.045, -0.0529921),
        (250.089, -0.1059842),
        (260.008, 13.0120009),
        (176.625, 13.3407154),
        (357.529, 0.9856003),
        (311.589, 26.4057084),
        (134.963, 13.0649930),
        (276.617, 0.3287146),
        (34.226, 1.7484877),
        (15.134, -0.1589763),
        (119.743, 0.0036096),
        (239.961, 0.1643573),
        (25.053, 12.9590088),
    )
)
"""E1 to E13: degrees at J2000, and degrees per day."""

MOON_RIGHT_ASCENSION = np.array(
    (-3.8787, -0.1204, 0.0700, -0.0172, 0, 0.0072, 0, 0, 0, -0.0052, 0, 0, 0.0043)
)
MOON_DECLINATION = np.array(
    (1.5419, 0.0239, -0.0278, 0.0068, 0, -0.0029, 0.0009, 0, 0, 0.0008, 0, 0, -0.0009)
)
MOON_MERIDIAN = np.array(
    (
        *(3.5610, 0.1208, -0.0642, 0.0158, 0.0252, -0.0066, -0.0047),
        *(-0.0046, 0.0028, 0.0052, 0.0040, 0.0019, -0.0044),
    )
)
"""Amplitudes of the sines (cosines) of E1 to E13."""

MARS_RIGHT_ASCENSION = np.array(
    (
        (0.000068, 198.991226, 19139.4819985),
        (0.000238, 226.292679, 38280.8511281),
        (0.000052, 249.663391, 57420.7251593),
        (0.000009, 266.183510, 76560.6367950),
        (0.419057, 79.398797, 0.5042615),
    )
)
MARS_DECLINATION = np.array(
    (
        (0.000051, 122.433576, 19139.9407476),
        (0.000141, 43.058401, 38280.8753272),
        (0.000031, 57.663379, 57420.7517205),
        (0.000005, 79.476401, 76560.6495004),
        (1.591274, 166.325722, 0.5042615),
    )
)
MARS_MERIDIAN = np.array(
    (
        (0.000145, 129.071773, 19140.0328244),
        (0.000157, 36.352167, 38281.0473591),
        (0.000040, 56.668646, 57420.9295360),
        (0.000001, 67.364003, 76560.2552215),
        (0.000001, 104.792680, 95700.4387578),
        (0.584542, 95.391654, 0.5042615),
    )
)
"""Amplitude, degrees at J2000, and degrees per century."""


def body_from_icrf(body: Literal["moon", "mars"], days: float) -> FloatArray:
    """Return the (3, 3) rotation of vectors in the ICRF into a body's own axes.

    These are x to longitude 0 on the equator, z to the north pole.

    Args:
        body: The body.
        days: Days of barycentric dynamical time since J2000.
    """
    right_ascension, declination, meridian = _moon_deg(days) if body == "moon" else _mars_deg(days)
    turns_deg = (90 + right_ascension, 90 - declination, meridian)
    # Intrinsic turns carry the ICRF's axes into the body's.
    # Loaded here: whoever checks a configuration needs none of it.
    rotation = scipy.spatial.transform.Rotation
    return np.asarray(rotation.from_euler("ZXZ", turns_deg, degrees=True).as_matrix().T)


def _moon_deg(days: float) -> tuple[float, float, float]:
    """Return right ascension and declination of the pole, and the prime meridian's angle."""
    t = days / DAYS_PER_CENTURY
    angles = np.radians(MOON_ANGLES @ (1.0, days))
    sines, cosines = np.sin(angles), np.cos(angles)
    return (
        269.9949 + 0.0031 * t + float(MOON_RIGHT_ASCENSION @ sines),
        66.5392 + 0.0130 * t + float(MOON_DECLINATION @ cosines),
        38.3213 + 13.17635815 * days - 1.4e-12 * days**2 + float(MOON_MERIDIAN @ sines),
    )


def _mars_deg(days: float) -> tuple[float, float, float]:
    """Return right ascension and declination of the pole, and the prime meridian's angle."""
    t = days / DAYS_PER_CENTURY

    def angles(series: FloatArray) -> FloatArray:
        return np.asarray(np.radians(series[:, 1:] @ (1.0, t)))

    return (
        317.269202
        - 0.10927547 * t
        + float(MARS_RIGHT_ASCENSION[:, 0] @ np.sin(angles(MARS_RIGHT_ASCENSION))),
        54.432516
        - 0.05827105 * t
        + float(MARS_DECLINATION[:, 0] @ np.cos(angles(MARS_DECLINATION))),
        176.049863
        + 350.891982443297 * days
        + float(MARS_MERIDIAN[:, 0] @ np.sin(angles(MARS_MERIDIAN))),
    )
