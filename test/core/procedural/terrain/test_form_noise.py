"""Noise with forms: ridges run down slopes, craters have rims and floors, and both repeat."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.procedural.terrain.surroundings.form_noise import craters, ridges
from oaisys_core.types import FloatArray


def places(size_px: int, cells: float) -> FloatArray:
    at = np.linspace(0.0, cells, size_px, endpoint=False)
    return np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)


def test_ridges_run_down_the_slope_and_have_crests_sharper_than_beds() -> None:
    xy = places(256, 16.0)
    downhill = np.tile((0.3, 0.0), (len(xy), 1))
    height = ridges(xy, downhill, np.random.default_rng(1)).height.reshape(256, 256)
    along, across = np.diff(height, axis=1), np.diff(height, axis=0)
    assert across.std() > 2 * along.std()
    bent = np.diff(height, n=2, axis=0)
    assert -bent.min() > 2 * bent.max(), "crests are sharp, beds are round"
    assert height.std() == pytest.approx(1.0, abs=0.15)
    assert abs(height.mean()) < 0.1


def test_uphill_and_downhill_give_the_same_ridges() -> None:
    xy, rng = places(64, 8.0), np.random.default_rng
    downhill = rng(0).normal(size=(len(xy), 2))
    one, other = ridges(xy, downhill, rng(1)), ridges(xy, -2.0 * downhill, rng(1))
    np.testing.assert_allclose(one.height, other.height, atol=1e-3)


def test_the_slopes_of_ridges_point_where_they_rise() -> None:
    xy, rng = places(128, 8.0), np.random.default_rng
    downhill = np.tile((0.0, -1.0), (len(xy), 1))
    forms = ridges(xy, downhill, rng(2))
    ahead = ridges(xy + np.array((0.01, 0.0)), downhill, rng(2)).height
    risen = ahead - forms.height
    clear = np.abs(forms.slope[:, 0]) > 2.0
    assert (np.sign(risen[clear]) == np.sign(forms.slope[clear, 0])).mean() > 0.97


@pytest.mark.parametrize("period", [5, 8])
def test_forms_repeat_after_their_period(period: int) -> None:
    xy, rng = places(32, period), np.random.default_rng
    downhill = np.tile((0.6, 0.8), (len(xy), 1))
    for shift in ((period, 0), (0, -period)):
        one = ridges(xy, downhill, rng(3), period).height
        again = ridges(xy + shift, downhill, rng(3), period).height
        np.testing.assert_allclose(again, one, atol=1e-3)
        pits = craters(xy, rng(4), period)
        np.testing.assert_allclose(craters(xy + shift, rng(4), period), pits, atol=1e-3)


def test_craters_are_hollows_below_the_plain_with_rims_above_it() -> None:
    height = craters(places(512, 24.0), np.random.default_rng(5))
    low, middle, high = np.quantile(height, (0.001, 0.5, 0.999))
    assert middle - low > 2 * (high - middle) > 0
    assert (height < middle - 1.0).mean() < 0.25, "most of the ground is plain"
    assert height.std() == pytest.approx(1.0, abs=0.2)
