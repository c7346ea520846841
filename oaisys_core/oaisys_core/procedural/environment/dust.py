"""Sunlight under a dusty atmosphere: how much arrives directly, and how much from the sky.

A two-stream solution with the delta-Eddington approximation (Joseph, Wiscombe and Weinman 1976, in
the form of Meador and Weaver 1980) for a layer of dust above a reflecting ground, as Haberle et al.
(1993) used it for Mars. With Mars' dust it is within 0.04 of the net fluxes that Pollack computed
with many wavelengths and all orders of scattering (Appelbaum and Flood 1990), for optical depths up
to 2 and suns 10 degrees and more above the horizon.
"""

from __future__ import annotations

from math import exp, radians, sin, sqrt
from typing import NamedTuple

SINGLE_SCATTERING_ALBEDO = 0.86
ASYMMETRY = 0.79
"""Mars' dust in sunlight (Pollack et al. 1979, after pictures of the Viking landers)."""

GROUND_ALBEDO = 0.2

MIN_ELEVATION_RAD = radians(1.0)
"""Lower suns are treated as this one, because the model is of a flat layer."""


class SunlightShares(NamedTuple):
    """Shares of the irradiance that a surface facing the sun receives above the atmosphere.

    Attributes:
        direct: On a surface facing the sun, from the sun's disc.
        diffuse: On level ground, from the sky.
    """

    direct: float
    diffuse: float


def shares_under_dust(
    optical_depth: float, sun_elevation_rad: float, ground_albedo: float = GROUND_ALBEDO
) -> SunlightShares:
    """Return the shares of sunlight under dust of an optical depth towards the zenith."""
    up = sin(max(sun_elevation_rad, MIN_ELEVATION_RAD))
    direct = exp(-optical_depth / up)
    transmitted, reflected_down = _transmission(optical_depth, up)
    on_level = up * transmitted / (1 - ground_albedo * reflected_down)
    return SunlightShares(direct, max(on_level - up * direct, 0.0))


def _transmission(optical_depth: float, up: float) -> tuple[float, float]:
    """Return the transmission of sunlight, and the reflection of light from below.

    ``up`` is the cosine of the sun's angle from the zenith.
    """
    # The peak of forward scattering counts as light that was not scattered.
    forward = ASYMMETRY**2
    depth = (1 - SINGLE_SCATTERING_ALBEDO * forward) * optical_depth
    albedo = (1 - forward) * SINGLE_SCATTERING_ALBEDO / (1 - SINGLE_SCATTERING_ALBEDO * forward)
    g = ASYMMETRY / (1 + ASYMMETRY)
    # Coefficients of the Eddington approximation, named as by Meador and Weaver.
    gamma1 = (7 - albedo * (4 + 3 * g)) / 4
    gamma2 = -(1 - albedo * (4 - 3 * g)) / 4
    gamma3 = (2 - 3 * g * up) / 4
    gamma4 = 1 - gamma3
    alpha1 = gamma1 * gamma4 + gamma2 * gamma3
    k = sqrt(gamma1**2 - gamma2**2)
    fading, direct = exp(-k * depth), exp(-depth / up)
    # Meador and Weaver's equations 15 and 17, multiplied by exp(-k depth) against overflow.
    least = (k + gamma1) + (k - gamma1) * fading**2
    scattered = (
        (1 + k * up) * (alpha1 + k * gamma4) * direct
        - (1 - k * up) * (alpha1 - k * gamma4) * fading**2 * direct
        - 2 * k * (gamma4 + alpha1 * up) * fading
    )
    resonance = 1 - (k * up) ** 2
    transmitted = direct - albedo * scattered / (resonance * least)
    return transmitted, gamma2 * (1 - fading**2) / least
