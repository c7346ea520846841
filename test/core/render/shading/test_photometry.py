"""Photometric laws against their publications, other people's code, and integrals."""

from __future__ import annotations

from math import acos, cos, log, pi, radians, sin

import numpy as np
import pytest

from oaisys_core.render.shading.photometry import law_factors, relative_to_lambert, to_source
from oaisys_core.scene.photometric_laws import (
    Hapke,
    LommelSeeliger,
    LunarLambert,
    PhotometricLaw,
)
from oaisys_core.verification.light.photometric_forms import hapke, lunar_lambert, radiance_factor

MOON = Hapke(0.32, 0.24, 0.30, 1.8, 0.071, radians(23.4))
SMOOTH = Hapke(0.9, 0.1, -0.5, 0.0, 0.1, 0.0)
LAWS = (LommelSeeliger(), LunarLambert(), MOON, SMOOTH)
STANDARD = 1 + cos(radians(30.0))

ANGLES_DEG = ((30, 0, 0), (50, 50, 0), (20, 60, 40), (60, 20, 40), (70, 60, 180), (45, 45, 90))
"""Of incidence, of emergence, and between their planes."""

OTHERS = (0.07999, 0.18493, 0.08501, 0.04524, 0.01799, 0.05639)
"""Pi times the radiance by MOON there, as the BSDF ``hapke`` of eradiate-mitsuba 0.5.0 has it; its
c is (1 + c) / 2 of ours."""


def phase(i: float, e: float, azimuth: float) -> float:
    return acos(max(-1.0, min(1.0, cos(i) * cos(e) + sin(i) * sin(e) * cos(azimuth))))


def test_hapkes_closed_form_is_that_of_another_implementation() -> None:
    for angles_deg, expected in zip(ANGLES_DEG, OTHERS, strict=True):
        i, e, azimuth = (radians(each) for each in angles_deg)
        assert hapke(MOON, i, e, phase(i, e, azimuth)) == pytest.approx(expected, abs=6e-6)


def test_mcewens_share_goes_from_lommel_seeliger_to_lambert() -> None:
    i, e = radians(40.0), radians(25.0)
    assert lunar_lambert(i, e, 0.0) == pytest.approx(2 * cos(i) / (cos(i) + cos(e)))
    assert lunar_lambert(i, e, radians(120.0)) == pytest.approx(cos(i))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_what_is_rendered_is_the_published_law(law: PhotometricLaw) -> None:
    rng = np.random.default_rng(7)
    i, e = np.arccos(rng.uniform(0.03, 1.0, (2, 300)))
    azimuth = rng.uniform(0.0, pi, 300)
    g = np.array([phase(*each) for each in zip(i, e, azimuth, strict=True)])
    found = relative_to_lambert(law, np.cos(i), np.cos(e), np.cos(g)) * np.cos(i)
    expected = [radiance_factor(1.0, law, *each) for each in zip(i, e, g, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_sun_and_eye_may_change_places(law: PhotometricLaw) -> None:
    one = relative_to_lambert(law, np.array([0.3]), np.array([0.8]), np.array([0.5]))
    other = relative_to_lambert(law, np.array([0.8]), np.array([0.3]), np.array([0.5]))
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_light_from_everywhere_is_an_integral() -> None:
    """Lommel and Seeliger's law has one: 2 (1 - mu log(1 + 1 / mu)) times its constant."""
    for mu in (0.2, 0.5, 0.9):
        normals = np.array([[0.0, 0.0, 1.0]])
        rays = np.array([[(1 - mu * mu) ** 0.5, 0.0, -mu]]) * 3.0
        _, of_sky = law_factors(LommelSeeliger(), normals, rays, (0.0, 0.0, 1.0))
        assert of_sky[0] == pytest.approx(2 * STANDARD * (1 - mu * log(1 + 1 / mu)), rel=0.01)


def test_surfaces_that_face_away_are_finite() -> None:
    cosines = np.array([-1.0, -0.5, 0.0, 1.0])
    for law in LAWS:
        assert np.isfinite(relative_to_lambert(law, cosines, cosines, cosines)).all()


def test_beams_see_the_opposition_surge() -> None:
    level = np.array([1.0])
    calm = Hapke(MOON.w, MOON.b, MOON.c, 0.0, MOON.h, MOON.theta_bar_rad)
    assert to_source(MOON, level)[0] > 1.4 * to_source(calm, level)[0]
    np.testing.assert_allclose(
        to_source(LommelSeeliger(), np.array([1.0, 0.5])), [STANDARD / 2, STANDARD]
    )
