"""What the audit of light expects of photometric laws, from their publications alone.

Nothing here is used to render. Functions return the radiance factor (pi times the radiance by an
irradiance of 1 across the beam), all angles are in radians: ``i`` of incidence, ``e`` of emergence,
``g`` of phase.
"""

from __future__ import annotations

from math import acos, cos, degrees, exp, log, pi, radians, sin, sqrt, tan

from oaisys_core.scene.photometric_laws import Hapke, LommelSeeliger, PhotometricLaw

INCIDENCE = radians(30.0)
"""At which, seen from above, the radiance factor is the albedo times the cosine."""


def radiance_factor(albedo: float, law: PhotometricLaw, i: float, e: float, g: float) -> float:
    """Return the radiance factor of ground of an albedo, as docs/light.md defines that."""
    form = _form(law, i, e, g) / _form(law, INCIDENCE, 0.0, INCIDENCE)
    return albedo * cos(INCIDENCE) * form


def _form(law: PhotometricLaw, i: float, e: float, g: float) -> float:
    if isinstance(law, LommelSeeliger):
        return cos(i) / (cos(i) + cos(e))
    if isinstance(law, Hapke):
        return hapke(law, i, e, g)
    return lunar_lambert(i, e, g)


def lunar_lambert(i: float, e: float, g: float) -> float:
    """Return McEwen's law (1991), with L of McEwen (1996) for the Moon, cut off at 0."""
    a = degrees(g)
    share = max(0.0, 1 - 0.019 * a + 0.242e-3 * a**2 - 1.46e-6 * a**3)
    return 2 * share * cos(i) / (cos(i) + cos(e)) + (1 - share) * cos(i)


def hapke(law: Hapke, i: float, e: float, g: float) -> float:
    """Return pi times Hapke's bidirectional reflectance (2012, chapter 12.3).

    It has his approximation of H of 2002, no coherent backscattering and no porosity.
    """
    b, c = law.b, law.c
    lobes = (1 + c) / 2 * (1 - b**2) / pow(1 - 2 * b * cos(g) + b**2, 1.5)
    lobes += (1 - c) / 2 * (1 - b**2) / pow(1 + 2 * b * cos(g) + b**2, 1.5)
    surge = 1 + law.b0 / (1 + tan(g / 2) / law.h)
    mu0, mu, shadowing = _effective(law.theta_bar_rad, i, e, g)
    several = _h(law.w, mu0) * _h(law.w, mu) - 1
    return float(law.w / 4 * mu0 / (mu0 + mu) * (lobes * surge + several) * shadowing)


def _h(w: float, x: float) -> float:
    r0 = (1 - sqrt(1 - w)) / (1 + sqrt(1 - w))
    return 1 / (1 - w * x * (r0 + (1 - 2 * r0 * x) / 2 * log((1 + x) / x)))


def _effective(theta: float, i: float, e: float, g: float) -> tuple[float, float, float]:
    """Return the effective cosines of incidence and emergence, and S, of Hapke (1984)."""
    if theta == 0:
        return cos(i), cos(e), 1.0
    chi = 1 / sqrt(1 + pi * tan(theta) ** 2)
    psi = _azimuth(i, e, g)
    f = exp(-2 * tan(psi / 2)) if psi < pi else 0.0

    def e1(x: float) -> float:
        return exp(-2 / (pi * tan(theta) * tan(x))) if x > 0 else 0.0

    def e2(x: float) -> float:
        return exp(-1 / (pi * tan(theta) ** 2 * tan(x) ** 2)) if x > 0 else 0.0

    def eta(x: float) -> float:
        return chi * (cos(x) + sin(x) * tan(theta) * e2(x) / (2 - e1(x)))

    half = sin(psi / 2) ** 2
    if i <= e:
        rest = 2 - e1(e) - psi / pi * e1(i)
        mu0 = chi * (cos(i) + sin(i) * tan(theta) * (cos(psi) * e2(e) + half * e2(i)) / rest)
        mu = chi * (cos(e) + sin(e) * tan(theta) * (e2(e) - half * e2(i)) / rest)
        shadows = chi / (1 - f + f * chi * cos(i) / eta(i))
    else:
        rest = 2 - e1(i) - psi / pi * e1(e)
        mu0 = chi * (cos(i) + sin(i) * tan(theta) * (e2(i) - half * e2(e)) / rest)
        mu = chi * (cos(e) + sin(e) * tan(theta) * (cos(psi) * e2(i) + half * e2(e)) / rest)
        shadows = chi / (1 - f + f * chi * cos(e) / eta(e))
    return mu0, mu, mu / eta(e) * cos(i) / eta(i) * shadows


def _azimuth(i: float, e: float, g: float) -> float:
    """Return the angle between the planes of incidence and emergence."""
    sines = sin(i) * sin(e)
    if sines < 1e-9:
        return 0.0
    return acos(max(-1.0, min(1.0, (cos(g) - cos(i) * cos(e)) / sines)))
