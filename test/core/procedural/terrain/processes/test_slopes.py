"""What gravity does, against the error function and the angle of repose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from oaisys_core.procedural.terrain.processes.slopes import diffuse, slide, wear_back


def test_a_step_creeps_into_an_error_function() -> None:
    x = np.arange(128) - 63.5
    amount_m2 = 30.0
    crept = diffuse(np.tile((x > 0) * 2.0 - 1, (4, 1)), 1.0, amount_m2)
    assert crept == pytest.approx(np.tile(erf(x / np.sqrt(4 * amount_m2)), (4, 1)), abs=2e-3)


def test_creep_keeps_the_mass() -> None:
    z = np.random.default_rng(0).uniform(0, 5, (40, 64))
    assert diffuse(z, 0.5, 3.0).sum() == pytest.approx(z.sum(), rel=1e-12)


@pytest.mark.parametrize("repose_deg", [20.0, 34.0, 45.0])
def test_a_pile_slides_to_the_angle_of_repose_and_keeps_its_mass(repose_deg: float) -> None:
    axis = np.arange(65) - 32.0
    radius = np.hypot(axis[None, :], axis[:, None])
    z = np.where(radius < 6, 20.0, 0.0)
    settled = slide(z, 1.0, np.tan(np.radians(repose_deg)), 1500)
    slope_deg = np.degrees(np.arctan(np.hypot(*np.gradient(settled))))
    assert slope_deg.max() < repose_deg + 1.5
    assert settled.sum() == pytest.approx(z.sum(), rel=1e-9)
    # A cone, alike in all directions: no octagon.
    flank = (settled > 1.0) & (radius > 8)
    assert np.std(settled[flank] + radius[flank] * np.tan(np.radians(repose_deg))) < 0.35


def test_hard_rock_stands_where_loose_ground_slides() -> None:
    z = np.tile(np.where(np.arange(64) < 32, 10.0, 0.0), (8, 1))
    repose = np.full(z.shape, np.tan(np.radians(33.0)))
    loose = slide(z, 1.0, repose, 300)
    hard = slide(z, 1.0, np.tan(np.radians(85.0)), 300)
    assert np.abs(np.diff(loose[4])).max() < 0.75
    assert np.abs(np.diff(hard[4])).max() > 5.0


def test_a_wall_wears_back_to_a_slope_that_starts_at_its_foot() -> None:
    wall = np.zeros((61, 61))
    wall[:, 30:] = 3.0
    worn = wear_back(wall, 0.5, 0.6, reach=20)
    assert (worn <= wall).all()
    np.testing.assert_array_equal(worn[:, :30], 0.0)
    expected = np.tile(0.3 * np.arange(1, 11), (51, 1))
    np.testing.assert_allclose(worn[5:-5, 30:40], expected, atol=0.4)
    np.testing.assert_array_equal(worn[:, 45:], 3.0)
    assert np.diff(worn, axis=1).max() <= 0.6 * 0.5 * 1.25 + 1e-9
