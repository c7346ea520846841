"""How much the ground reflects by a photometric law, relative to Lambert's.

All formulas are made of numpy's universal functions alone, so that they can be evaluated by
whatever implements those: arrays, or shader nodes.
"""

from __future__ import annotations

from functools import cache
from math import cos, pi, radians, sqrt, tan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene.photometric_laws import Hapke, LommelSeeliger, PhotometricLaw
from oaisys_core.types import FloatArray

STANDARD_COS = cos(radians(30.0))
"""Of the incidence at which all laws are 1, seen from above."""

MIN_COS = 0.02
"""Least cosine between a normal and a direction; beyond 88.9 degrees, laws stay as they are."""

MIN_SINE_SQUARE = 1e-5

MCEWEN = (-0.019, 2.42e-4, -1.46e-6)
"""Coefficients of the share of Lommel and Seeliger's law, by the phase angle in degrees: McEwen
(1996), A precise lunar photometric function, Lunar and Planetary Science 27, 841."""

DIRECTIONS = 24
"""Steps of each angle over which light from all directions is summed up."""


def relative_to_lambert(law: PhotometricLaw, sun_cos: Any, view_cos: Any, phase_cos: Any) -> Any:
    """Return the reflectance relative to Lambert's law, which is 1 in the standard geometry.

    Args:
        law: The law.
        sun_cos: (N,) cosines of the angle between normal and sun; of surfaces that face away from
            it, what they would have on the other side.
        view_cos: (N,) cosines of the angle between normal and eye.
        phase_cos: (N,) cosines of the angle between sun and eye.
    """
    sun_cos = np.minimum(np.maximum(np.absolute(sun_cos), MIN_COS), 1.0)
    view_cos = np.minimum(np.maximum(view_cos, MIN_COS), 1.0)
    phase_cos = np.minimum(np.maximum(phase_cos, -1.0), 1.0)
    standard = _reflectance(law, np.array(STANDARD_COS), np.array(1.0), np.array(STANDARD_COS))
    return _reflectance(law, sun_cos, view_cos, phase_cos) * (1 / float(standard))


def _reflectance(law: PhotometricLaw, sun_cos: Any, view_cos: Any, phase_cos: Any) -> Any:
    """Return the radiance by an irradiance of 1, up to a factor that is the same everywhere."""
    if isinstance(law, LommelSeeliger):
        return 1.0 / (sun_cos + view_cos)
    if isinstance(law, Hapke):
        return _hapke(law, sun_cos, view_cos, phase_cos)
    return _lunar_lambert(sun_cos, view_cos, phase_cos)


def _lunar_lambert(sun_cos: Any, view_cos: Any, phase_cos: Any) -> Any:
    """Return McEwen's law (1991, Icarus 92, 298) with the share of 1996, without a phase function.

    The polynomial of the share is below 0 from 104 degrees on.
    """
    first, second, third = MCEWEN
    phase_deg = np.arccos(phase_cos) * (180 / pi)
    share = phase_deg * (phase_deg * (phase_deg * third + second) + first) + 1.0
    share = np.minimum(np.maximum(share, 0.0), 1.0)
    return share * 2.0 / (sun_cos + view_cos) + (1.0 - share)


def _hapke(law: Hapke, sun_cos: Any, view_cos: Any, phase_cos: Any) -> Any:
    """Return Hapke's reflectance (Hapke 2012, Theory of Reflectance and Emittance Spectroscopy).

    Its phase function has two lobes, its function H is that of 2002, and its opposition surge that
    of shadows. Macroscopic roughness is that of Hapke (1984), Icarus 59, 41, which is the same if
    sun and eye change places; so ``low`` is the direction nearer to the normal, ``high`` the other.
    """
    low_cos, high_cos = np.maximum(sun_cos, view_cos), np.minimum(sun_cos, view_cos)
    if law.theta_bar_rad > 0:
        low, high, shadowing = _roughened(law.theta_bar_rad, low_cos, high_cos, phase_cos)
    else:
        low, high, shadowing = low_cos, high_cos, 1.0
    half_tan = np.sqrt((1.0 - phase_cos) / np.maximum(phase_cos + 1.0, 1e-6))
    surge = law.b0 / (half_tan * (1 / law.h) + 1.0) + 1.0
    several = _h_function(law.w, low) * _h_function(law.w, high) - 1.0
    scattered = surge * _two_lobes(law, phase_cos) + several
    return scattered * shadowing / (low + high)


def _two_lobes(law: Hapke, phase_cos: Any) -> Any:
    base, b = 1 + law.b**2, law.b
    back = (1 + law.c) / 2 * (1 - b * b) / np.power(base - phase_cos * (2 * b), 1.5)
    forward = (1 - law.c) / 2 * (1 - b * b) / np.power(phase_cos * (2 * b) + base, 1.5)
    return back + forward


def _h_function(w: float, cosine: Any) -> Any:
    """Return Hapke's approximation (2002, Icarus 157, 523) of Chandrasekhar's function."""
    gamma = sqrt(1 - w)
    r0 = (1 - gamma) / (1 + gamma)
    turned = np.log((cosine + 1.0) / cosine) * (0.5 - cosine * r0) + r0
    return 1.0 / (1.0 - cosine * turned * w)


def _roughened(
    theta_bar_rad: float, low_cos: Any, high_cos: Any, phase_cos: Any
) -> tuple[Any, Any, Any]:
    """Return the effective cosines of both directions, and the factor of shadows.

    The factor has the change of the effective cosine of the sun, which the reflectance lacks.
    """
    tangent = tan(theta_bar_rad)
    x = 1 / sqrt(1 + pi * tangent**2)
    low_sin, high_sin = _sine(low_cos), _sine(high_cos)
    low_cot, high_cot = low_cos / low_sin, high_cos / high_sin
    low_e1 = np.exp(low_cot * (-2 / (pi * tangent)))
    high_e1 = np.exp(high_cot * (-2 / (pi * tangent)))
    low_e2 = np.exp(low_cot * low_cot * (-1 / (pi * tangent**2)))
    high_e2 = np.exp(high_cot * high_cot * (-1 / (pi * tangent**2)))
    azimuth_cos = (phase_cos - low_cos * high_cos) / (low_sin * high_sin)
    azimuth_cos = np.minimum(np.maximum(azimuth_cos, -1.0), 1.0)
    half_sin_square = 0.5 - azimuth_cos * 0.5
    denominator = 2.0 - high_e1 - np.arccos(azimuth_cos) * (1 / pi) * low_e1
    bent = tangent / denominator
    low = (low_cos + low_sin * bent * (azimuth_cos * high_e2 + half_sin_square * low_e2)) * x
    high = (high_cos + high_sin * bent * (high_e2 - half_sin_square * low_e2)) * x
    low_eta = (low_cos + low_sin * tangent * low_e2 / (2.0 - low_e1)) * x
    high_eta = (high_cos + high_sin * tangent * high_e2 / (2.0 - high_e1)) * x
    half_tan = np.sqrt(half_sin_square / np.maximum(1.0 - half_sin_square, 1e-6))
    hidden = np.exp(half_tan * -2.0)
    shadows = x / (1.0 - hidden + hidden * low_cos * x / low_eta)
    return low, high, low * high * shadows / (low_eta * high_eta)


def _sine(cosine: Any) -> Any:
    return np.sqrt(np.maximum(1.0 - cosine * cosine, MIN_SINE_SQUARE))


def law_factors(
    law: PhotometricLaw,
    normals: NDArray[np.floating[Any]],
    rays: NDArray[np.floating[Any]],
    to_sun: tuple[float, float, float],
) -> tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]]:
    """Return the (N,) reflectances relative to Lambert's law, of sunlight and of the sky's light.

    Args:
        law: The law.
        normals: (N, 3) unit vectors; the factors have their type.
        rays: (N, 3) from the eye, of any length.
        to_sun: Unit vector towards the sun.
    """
    to_eye = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    view_cos = np.einsum("ij,ij->i", normals, to_eye)
    sun = np.array(to_sun, dtype=normals.dtype)
    of_sun = relative_to_lambert(law, normals @ sun, view_cos, to_eye @ sun)
    return of_sun, np.interp(view_cos, *_diffuse_factors(law)).astype(normals.dtype)


def to_source(law: PhotometricLaw, incidence_cos: FloatArray) -> FloatArray:
    """Return the (N,) reflectances relative to Lambert's law of light that goes back to its source.

    Args:
        law: The law.
        incidence_cos: (N,) cosines of the angle between normal and beam.
    """
    cosines = np.asarray(incidence_cos)
    return np.asarray(relative_to_lambert(law, cosines, cosines, np.ones_like(cosines)))


@cache
def _diffuse_factors(law: PhotometricLaw) -> tuple[FloatArray, FloatArray]:
    """Return cosines of the eye's angle, and factors of light that comes from everywhere alike."""
    steps = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    # Equal steps of the cosine's square receive equal irradiance.
    light_cos = np.sqrt(steps)[:, None]
    view_cos = steps[:, None, None]
    sines = np.sqrt((1 - view_cos**2) * (1 - light_cos**2))
    phase_cos = view_cos * light_cos + sines * np.cos(pi * steps)
    light, view = (np.broadcast_to(each, phase_cos.shape) for each in (light_cos, view_cos))
    return steps, relative_to_lambert(law, light, view, phase_cos).mean(axis=(1, 2))
