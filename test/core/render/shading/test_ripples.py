"""Ripples that a picture of water does not show, against Cox and Munk's facets one by one."""

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.render.draft.ground.water import fresnel
from oaisys_core.render.shading.ripples import (
    MAX_SLOPE,
    RIPPLES_TO_M,
    slope_towards_eye,
    variance_not_shown,
)


def as_one(value: float) -> NDArray[np.float32]:
    return np.array([value], np.float32)


@pytest.mark.parametrize("elevation_deg", [0.5, 2, 10, 45])
@pytest.mark.parametrize(("waves", "limit"), [(0.3, 0.03), (1.0, 0.09)])
def test_far_water_mirrors_as_much_as_its_facets_do(
    elevation_deg: float, waves: float, limit: float
) -> None:
    up, ahead = np.sin(np.radians(elevation_deg)), np.cos(np.radians(elevation_deg))
    deviation = waves * MAX_SLOPE
    axis = np.linspace(-4, 4, 161)
    along, across = np.meshgrid(deviation * axis, deviation * axis)
    chance = np.exp(-(along**2 + across**2) / (2 * deviation**2))
    shown = chance * np.maximum(0, 1 + along * ahead / up)
    cos = (along * ahead + up) / np.sqrt(1 + along**2 + across**2)
    facets = fresnel(np.clip(cos, 1e-4, 1).astype(np.float32))
    expected = (shown * facets).sum() / shown.sum()

    lean = float(slope_towards_eye(as_one(deviation**2), as_one(ahead / up))[0])
    found = fresnel(as_one((lean * ahead + up) / (1 + lean**2) ** 0.5))[0]
    assert found == pytest.approx(expected, abs=limit)


def test_a_mirror_hides_no_ripples_and_near_water_shows_all() -> None:
    assert variance_not_shown(as_one(RIPPLES_TO_M), as_one(0.1))[0] == 0
    assert variance_not_shown(as_one(1e4), as_one(0.1))[0] == pytest.approx(0.01, rel=1e-3)
    assert slope_towards_eye(as_one(0.0), as_one(50.0))[0] == 0
