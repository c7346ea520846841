"""The law of reflection against Lambert's, against its article's formulas, and for its energy."""

from math import acos, pi, sqrt

import numpy as np
import pytest

from oaisys_core.render.draft.light.diffuse import RoughDiffuse
from oaisys_core.types import FloatArray

UP = np.array((0.0, 0.0, 1.0))


def direction(elevation_deg: float, azimuth_deg: float = 0.0) -> FloatArray:
    up, around = np.radians((elevation_deg, azimuth_deg))
    return np.array((np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)))


def radiance(albedo: float, roughness: float, light: FloatArray, eye: FloatArray) -> float:
    law = RoughDiffuse(
        np.full((1, 3), albedo, np.float32),
        np.full(1, roughness, np.float32),
        np.array([eye[2]], np.float32),
    )
    cosines = (np.array([each], np.float32) for each in (light[2], light @ eye))
    return float(law.radiance(*cosines)[0, 0])


def by_the_article(albedo: float, roughness: float, light: FloatArray, eye: FloatArray) -> float:
    """The exact albedo of single scattering, instead of its polynomial, and Cycles' third power."""
    fade = 1 / (1 + (1 / 2 - 2 / (3 * pi)) * roughness)

    def single(cos: float) -> float:
        sin = sqrt(1 - cos * cos)
        turned = sin * (acos(cos) - sin * cos) + 2 / 3 * ((sin / cos) * (1 - sin**3) - sin)
        return fade + roughness * fade / pi * turned

    apart = light @ eye - light[2] * eye[2]
    apart /= max(light[2], eye[2]) if apart > 0 else 1
    mean = fade * (1 + (2 / 3 - 28 / (15 * pi)) * roughness)
    # Cycles multiplies what is reflected several times by the colour once more.
    many = albedo**3 * mean / (1 - albedo * (1 - mean))
    lost = (1 - single(light[2])) * (1 - single(eye[2])) / (1 - mean) if roughness else 0.0
    return float((albedo * fade * (1 + roughness * apart) + many * lost) / pi * light[2])


@pytest.mark.parametrize("elevation_deg", [5, 30, 60, 90])
def test_smooth_surfaces_follow_lambert(elevation_deg: float) -> None:
    light = direction(elevation_deg)
    for eye in (UP, direction(20, 40), direction(45, 180)):
        assert radiance(0.3, 0.0, light, eye) == pytest.approx(0.3 / pi * light[2], rel=1e-4)


@pytest.mark.parametrize("roughness", [0.3, 0.9, 1.0])
@pytest.mark.parametrize("elevation_deg", [10, 30, 70])
def test_rough_surfaces_follow_the_article(roughness: float, elevation_deg: float) -> None:
    light = direction(elevation_deg)
    for azimuth_deg in (0, 60, 180):
        eye = direction(35, azimuth_deg)
        expected = by_the_article(0.4, roughness, light, eye)
        assert radiance(0.4, roughness, light, eye) == pytest.approx(expected, rel=0.01)


def test_rough_ground_is_brighter_towards_a_low_sun_than_by_lambert() -> None:
    sun = direction(10)
    with_the_light, against_it = (
        radiance(0.25, 0.9, sun, direction(15, azimuth)) / (0.25 / pi * sun[2])
        for azimuth in (0, 180)
    )
    assert with_the_light > 1.5
    assert against_it < 0.9


@pytest.mark.parametrize("roughness", [0.0, 0.5, 1.0])
def test_a_white_surface_returns_all_light(roughness: float) -> None:
    white = np.ones((90, 3), np.float32)
    cosines = np.linspace(0.01, 1, 90, dtype=np.float32)
    law = RoughDiffuse(white, np.full(90, roughness, np.float32), cosines)
    np.testing.assert_allclose(law.ambient(), 1.0, atol=2e-3)


def test_light_from_everywhere_is_the_sum_of_all_beams() -> None:
    eye, total, count = direction(25), 0.0, 40
    for up in (np.arange(count) + 0.5) / count:
        for azimuth in np.arange(60) * 6.0:
            light = direction(np.degrees(np.arcsin(up)), azimuth)
            total += radiance(0.5, 0.9, light, eye) * 2 * pi / (count * 60)
    law = RoughDiffuse(
        np.full((1, 3), 0.5, np.float32),
        np.full(1, 0.9, np.float32),
        np.array([eye[2]], np.float32),
    )
    # The radiance of a sky with a radiance of 1.
    assert law.ambient()[0, 0] == pytest.approx(total, rel=0.01)


def test_nothing_is_reflected_of_light_from_behind() -> None:
    assert radiance(0.5, 0.9, direction(-5), direction(30)) == 0.0
