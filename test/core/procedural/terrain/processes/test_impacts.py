"""Impact craters, against Pike's shapes, a production function and diffusion."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.procedural.terrain.processes.impacts import (
    STEP,
    WORN,
    Impacts,
    add_impacts,
    draw_impacts,
    fresh_profile,
    profile_of,
    worn_profiles,
)


def test_a_fresh_crater_is_a_fifth_as_deep_as_wide() -> None:
    radius = np.linspace(0, 0.5, 200, endpoint=False)
    profile = fresh_profile(radius)
    assert profile.max() - profile.min() == pytest.approx(0.2, abs=0.01)
    assert fresh_profile(np.array([0.5]))[0] == pytest.approx(0.036)


def test_craters_on_a_grid_are_as_deep_as_their_profile() -> None:
    impacts = Impacts(np.array([[32.0, 32.0]]), np.array([24.0]), np.array([0.0]))
    z = add_impacts(np.zeros((129, 129)), 0.5, impacts, np.random.default_rng(0))
    assert np.ptp(z) / 24.0 == pytest.approx(0.2, abs=0.02)


def test_wear_keeps_the_volume_and_fills_the_bowl() -> None:
    wears, profiles = worn_profiles()
    radius = (np.arange(profiles.shape[1]) + 0.5) * STEP
    volume = (profiles * radius).sum(axis=1)
    assert volume == pytest.approx(np.full(len(wears), volume[0]), rel=1e-9)
    depth = profiles.max(axis=1) - profiles[:, 0]
    assert (np.diff(depth) < 0).all()
    assert depth[-1] / depth[0] == pytest.approx(0.29, abs=0.1)
    assert profile_of(WORN) == pytest.approx(profiles[-1])


def test_wear_is_diffusion_in_the_plane() -> None:
    # Moments of a field under diffusion: the mean of r^2 grows by 4 * volume * K.
    wears, profiles = worn_profiles()
    radius = (np.arange(profiles.shape[1]) + 0.5) * STEP
    second = (profiles * radius**3).sum(axis=1)
    volume = (profiles[0] * radius).sum()
    early = slice(0, 8)
    growth = second[early] - second[0]
    edge = profiles[:, -1][early] * radius[-1] ** 2
    assert np.abs(growth - 4 * volume * wears[early]).max() < 0.05 * np.abs(second[0]) + edge.max()


def test_craters_follow_production_and_equilibrium() -> None:
    impacts = draw_impacts(
        1000.0,
        np.random.default_rng(1),
        smallest_m=1.0,
        largest_m=100.0,
        equilibrium_m=10.0,
        coverage=0.07,
    )
    more = [(impacts.diameter > size).sum() for size in (1.5, 3.0, 12.0, 24.0)]
    assert more[0] / more[1] == pytest.approx(4.0, rel=0.15)
    assert more[2] / more[3] == pytest.approx(8.0, rel=0.3)
    assert impacts.wear.max() <= WORN
    assert impacts.wear[impacts.diameter > 40].max() < 0.1 * WORN, "large ones last"


def test_the_youngest_crater_lies_on_top() -> None:
    impacts = draw_impacts(
        100.0,
        np.random.default_rng(1),
        smallest_m=2.0,
        largest_m=30.0,
        equilibrium_m=10.0,
        coverage=0.05,
    )
    age = impacts.wear * impacts.diameter**2
    assert (np.diff(age) <= 1e-12).all()
