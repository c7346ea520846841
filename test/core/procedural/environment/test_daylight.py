"""The light of cloudy skies on the ground, against sums over directions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import pi, radians

import numpy as np
import pytest
from coarse_clouds import coarse_clouds
from numpy.typing import NDArray

from oaisys_core.procedural.environment.clouds.daylight import (
    below_clouds_w_m2,
    daylight_factors,
    spread_share,
)
from oaisys_core.procedural.environment.clouds.dome import before_sky
from oaisys_core.procedural.environment.clouds.shadows import cloud_shadows
from oaisys_core.procedural.environment.light import sky_irradiance_w_m2, sun_color
from oaisys_core.scene.sky import Clouds, Sky

FAIR = Clouds(cover=0.35, base_m=1200.0, size_m=1500.0, thickness_m=900.0, seed=3)


@pytest.fixture(autouse=True)
def small_dome() -> Iterator[None]:
    """Clouds in a sixteenth of the directions: each test sums them up, or compares two sums."""
    with coarse_clouds():
        yield


def sky(cover: float, elevation_deg: float = 30.0) -> Sky:
    """A sky of one colour in all directions, before clouds."""
    return Sky(
        radians(elevation_deg),
        0.7,
        3.0,
        0.01,
        1.0,
        1.0,
        1.0,
        1.0,
        clouds=replace(FAIR, cover=cover),
    )


def directions_up(count: int) -> NDArray[np.float64]:
    """Return unit vectors whose density is that of the cosine of the angle from the vertical."""
    rng = np.random.default_rng(1)
    level, turn = np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * pi, count)
    up = np.sqrt(1 - level**2)
    return np.column_stack((level * np.cos(turn), level * np.sin(turn), up))


@pytest.mark.parametrize("cover", [0.35, 0.8, 1.0])
def test_light_below_clouds_is_the_sum_over_directions(cover: float) -> None:
    world = sky(cover)
    rays = directions_up(200_000)
    clear = np.tile(sky_irradiance_w_m2(world) / pi, (len(rays), 1))
    summed_w_m2 = pi * before_sky(world, rays, clear).mean(axis=0)
    np.testing.assert_allclose(below_clouds_w_m2(world), summed_w_m2, rtol=0.01)


def test_below_a_closed_layer_all_light_is_that_of_the_clouds() -> None:
    world = sky(1.0)
    lit_w_m2 = sky_irradiance_w_m2(world) * daylight_factors(world)
    np.testing.assert_allclose(lit_w_m2, below_clouds_w_m2(world), rtol=1e-6)
    shadows = cloud_shadows(world)
    assert shadows is not None
    assert shadows.share.max() < 1e-3
    # A fifth of the light of a clear day, as Krochmann and Seidl measured below thick clouds, and
    # grey where that of a clear sky is blue.
    sun_w_m2 = (
        world.sun_strength_w_m2 * np.sin(world.sun_elevation_rad) * np.array(sun_color(world))
    )
    clear_w_m2 = sun_w_m2 + sky_irradiance_w_m2(world)
    assert 0.1 < lit_w_m2.sum() / clear_w_m2.sum() < 0.35
    assert 0.7 < lit_w_m2[2] / lit_w_m2[0] < 1.15


def test_single_clouds_leave_the_light_of_the_sky() -> None:
    world = sky(0.5)
    assert spread_share(FAIR) == 0
    assert daylight_factors(world) == (1.0, 1.0, 1.0)
    assert daylight_factors(replace(world, clouds=None)) == (1.0, 1.0, 1.0)


def test_without_shadows_sun_and_sky_shine_as_without_clouds() -> None:
    """Below a closed layer, the clouds' light was added to that of the whole sun."""
    world = sky(1.0)
    assert world.clouds is not None
    assert max(daylight_factors(world)) != 1.0
    unshaded = replace(world, clouds=replace(world.clouds, shadows=False))
    assert daylight_factors(unshaded) == (1.0, 1.0, 1.0)


def test_light_changes_with_the_cover_without_a_step() -> None:
    covers = np.linspace(0.5, 1.0, 26)
    shares = np.array([spread_share(replace(FAIR, cover=float(each))) for each in covers])
    assert shares[0] == 0
    assert shares[-1] == 1
    assert (np.diff(shares) >= 0).all()
    assert np.diff(shares).max() < 0.1


def test_at_night_clouds_hide_the_sky() -> None:
    night = sky(1.0, elevation_deg=-10.0)
    factors = np.array(daylight_factors(night))
    assert np.isfinite(factors).all()
    assert (factors <= 1.0).all()
