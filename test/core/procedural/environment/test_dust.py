"""Sunlight under Mars' dust, against published fluxes."""

from __future__ import annotations

from math import cos, exp, radians

import numpy as np
import pytest

from oaisys_core.procedural.environment.dust import shares_under_dust

ALBEDO = 0.1
NET_FLUXES = {
    0.1: (0.885, 0.876, 0.857, 0.830, 0.755),
    0.3: (0.847, 0.826, 0.774, 0.708, 0.562),
    0.5: (0.810, 0.778, 0.708, 0.628, 0.452),
    1.0: (0.732, 0.670, 0.560, 0.455, 0.317),
    2.0: (0.582, 0.500, 0.378, 0.293, 0.208),
}
"""Net flux at the surface relative to that above the atmosphere, by optical depth and `ZENITH_DEG`,
over ground with `ALBEDO`: Appelbaum and Flood (1990), Solar radiation on Mars, table III, computed
by Pollack with many wavelengths and all orders of scattering."""
ZENITH_DEG = (0, 40, 60, 70, 80)


@pytest.mark.parametrize("optical_depth", NET_FLUXES)
def test_fluxes_are_those_of_pollacks_computation(optical_depth: float) -> None:
    found = []
    for zenith_deg in ZENITH_DEG:
        shares = shares_under_dust(optical_depth, radians(90 - zenith_deg), ALBEDO)
        on_level = cos(radians(zenith_deg))
        found.append((shares.direct + shares.diffuse / on_level) * (1 - ALBEDO))
    np.testing.assert_allclose(found, NET_FLUXES[optical_depth], atol=0.04)


def test_direct_light_fades_by_beers_law() -> None:
    assert shares_under_dust(0.7, radians(90)).direct == pytest.approx(exp(-0.7))
    assert shares_under_dust(0.3, radians(30)).direct == pytest.approx(exp(-0.6))


def test_without_dust_all_light_is_direct() -> None:
    shares = shares_under_dust(0.0, radians(9))
    assert shares.direct == 1
    assert shares.diffuse == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("optical_depth", [0.01, 0.3, 3.0, 10.0])
def test_no_light_is_made_at_any_height_of_the_sun(optical_depth: float) -> None:
    for elevation_deg in (-5, 0, 0.5, 9, 45, 90):
        elevation_rad = radians(elevation_deg)
        shares = shares_under_dust(optical_depth, elevation_rad)
        assert 0 <= shares.direct <= 1
        assert 0 <= shares.diffuse <= 1
        on_level = np.sin(max(elevation_rad, radians(1.0)))
        assert shares.direct * on_level + shares.diffuse <= 1.25 * on_level
