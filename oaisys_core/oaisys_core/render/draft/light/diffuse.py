"""The law by which rough surfaces reflect light: that of Cycles' diffuse shader.

It is the energy-preserving form of Oren and Nayar's model: J. Portsmouth, P. Kutz and S. Hill,
"EON: A Practical Energy-Preserving Rough Diffuse BRDF", Journal of Computer Graphics Techniques 14
(1), 2025. At a roughness of 0 it is Lambert's law.
"""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

FADE = 1 / 2 - 2 / (3 * pi)
MEAN_FADE = 2 / 3 - 28 / (15 * pi)
"""Constants of the model's albedo, in the direction of the normal and in the mean."""

ALBEDO = (0.0571085289, 0.491881867, -0.332181442, 0.0714429953)
"""Coefficients of the albedo's polynomial in 1 - cosine (section 3.2 of the article)."""

TINY = np.float32(1e-7)


class RoughDiffuse:
    """Reflectance of N points seen from one direction each.

    ``albedo`` is (N, 3) linear, ``roughness`` (N,) from 0 to 1, ``view_cos`` (N,) the cosine of the
    angle between the normal and the way to the eye.
    """

    def __init__(self, albedo: Floats, roughness: Floats, view_cos: Floats) -> None:
        self._albedo, self._roughness = albedo, roughness
        self._view_cos = np.clip(view_cos, TINY, 1)
        fade = 1 / (1 + np.float32(FADE) * roughness)
        self._fade = fade
        self._lost_to_eye = 1 - self._single_albedo(self._view_cos)
        mean = fade * (1 + np.float32(MEAN_FADE) * roughness)
        lost = np.maximum(1 - mean, TINY)
        # Light that is scattered more than once between the facets. The article has the square of
        # the albedo; Cycles multiplies by the colour once more.
        many = albedo * albedo * albedo * (mean / lost)[:, None]
        self._many = many / (1 - albedo * lost[:, None])

    def radiance(self, light_cos: Floats, both_cos: Floats) -> Floats:
        """Return (N, 3) radiance by an irradiance of 1 across the beam.

        Args:
            light_cos: (N,) cosine between the normal and the light; none comes from below.
            both_cos: (N,) cosine between the directions of light and eye.
        """
        lit = np.maximum(light_cos, 0)
        apart = both_cos - lit * self._view_cos
        apart /= np.where(apart > 0, np.maximum(np.maximum(lit, self._view_cos), TINY), 1)
        once = self._fade * (1 + self._roughness * apart) * lit
        lost_of_light = 1 - self._single_albedo(lit)
        often = self._lost_to_eye * lost_of_light * lit
        found = self._albedo * once[:, None] + self._many * often[:, None]
        return np.asarray(found * np.float32(1 / pi), np.float32)

    def ambient(self) -> Floats:
        """Return the (N, 3) share of light from everywhere that goes to the eye."""
        lost = self._lost_to_eye[:, None]
        mean = self._fade * (1 + np.float32(MEAN_FADE) * self._roughness)
        return np.asarray(
            self._albedo * (1 - lost) + self._many * lost * (1 - mean)[:, None], np.float32
        )

    def _single_albedo(self, cos: Floats) -> Floats:
        """Return the (N,) albedo of light that is scattered once, by the angle's cosine."""
        rest = 1 - cos
        a, b, c, d = (np.float32(each) for each in ALBEDO)
        turned = rest * (a + rest * (b + rest * (c + rest * d)))
        return np.asarray(self._fade * (1 + self._roughness * turned), np.float32)


def bent_share(facing: Floats, smooth_facing: Floats, bend_cos: Floats) -> Floats:
    """Return the (N,) share of light that reaches facets that a texture bends towards it.

    They would be hidden by others, were they real (M. Chiang, Y. K. Li and B. Burley, "Taming the
    Shadow Terminator", SIGGRAPH Talks 2019); Cycles does the same.

    Args:
        facing: (N,) cosines between the light and the bent normals.
        smooth_facing: (N,) cosines between the light and the surface's own normals.
        bend_cos: (N,) cosines between both normals.
    """
    g = np.clip(smooth_facing / np.maximum(facing * bend_cos, TINY), 0, 1)
    return np.asarray(g * (1 + g * (1 - g)), np.float32)
