"""What the audit of light expects, from formulas alone; nothing here is used to render.

Radiance and irradiance are in scene units; angles are in radians.
"""

from __future__ import annotations

from math import acos, pi, sqrt

import numpy as np

from oaisys_core.types import FloatArray


def lambert(albedo: float, irradiance: float) -> float:
    """Return the radiance of a diffuse surface (Lambert 1760)."""
    return albedo / pi * irradiance


def rough_from_above(albedo: float, roughness: float, sun_cos: float) -> float:
    """Return the radiance of level rough ground, seen from above, relative to Lambert's law.

    Oren and Nayar in the form of Fujii (2012), A tiny improvement of Oren-Nayar reflectance model,
    and light reflected several times after Portsmouth, Kutz and Hill (2024), EON: a practical
    energy-preserving rough diffuse BRDF; Cycles multiplies that part by the albedo once more.

    Args:
        albedo: Of the surface.
        roughness: From 0 to 1.
        sun_cos: Cosine of the sun's angle to the vertical.
    """
    a = 1 / (1 + (1 / 2 - 2 / (3 * pi)) * roughness)

    def share_reflected_once(mu: float) -> float:
        sine, angle = sqrt(1 - mu * mu), acos(mu)
        g = sine * (angle - sine * mu) + 2 / 3 * ((sine / mu) * (1 - sine**3) - sine)
        return a * (1 + roughness * g / pi)

    mean = a * (1 + (2 / 3 - 28 / (15 * pi)) * roughness)
    several = albedo**2 * mean / (1 - albedo * (1 - mean)) / (1 - mean)
    several *= (1 - share_reflected_once(sun_cos)) * (1 - share_reflected_once(1 - 1e-12))
    return a + several


def gradient_irradiance(zenith: float, horizon: float, power: float = 0.5) -> float:
    """Return the irradiance of level ground under a sky of this radiance.

    At the elevation e it is ``horizon (1 - w) + zenith w`` with w = sin(e)^power; times sin e, and
    integrated over the sky's solid angle, w becomes 2 pi / (power + 2) and 1 becomes pi. The CIE's
    overcast sky has a horizon of a third of the zenith and the power 1: 7 pi / 9 of the zenith.
    """
    return 2 * pi * (horizon * (0.5 - 1 / (power + 2)) + zenith / (power + 2))


def visible_share_of_disc(offset: FloatArray) -> FloatArray:
    """Return the share of a uniform disc above a straight edge.

    Args:
        offset: Of the disc's centre above the edge, in its radii.
    """
    u = np.clip(offset, -1.0, 1.0)
    return np.asarray(1 - (np.arccos(u) - u * np.sqrt(1 - u * u)) / pi)
