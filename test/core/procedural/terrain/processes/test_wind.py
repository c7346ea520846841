"""Sand in the wind: Werner's slabs."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from oaisys_core.procedural.terrain.processes.exact import tangent
from oaisys_core.procedural.terrain.processes.wind import SHADOW, blow, in_shadow

REPOSE = tangent(33.0)


@pytest.fixture(scope="module")
def dunes() -> np.ndarray:
    sand = np.full((64, 96), 3.0)
    return blow(sand, np.random.default_rng(0), steps=300, hop=3, repose=REPOSE)


def test_the_wind_keeps_the_sand(dunes: np.ndarray) -> None:
    assert dunes.sum() == pytest.approx(3.0 * dunes.size, rel=1e-9)
    assert dunes.min() >= -1e-9


def test_level_sand_becomes_dunes_that_stand_at_repose(dunes: np.ndarray) -> None:
    assert dunes.std() > 0.7
    smooth = scipy.ndimage.gaussian_filter(dunes, 1.0, mode="wrap")
    assert np.hypot(*np.gradient(smooth)).max() < 1.4 * REPOSE


def test_dunes_travel_with_the_wind(dunes: np.ndarray) -> None:
    later = blow(dunes, np.random.default_rng(1), steps=12, hop=3, repose=REPOSE)
    one, other = (scipy.ndimage.gaussian_filter(each, 1.0, mode="wrap") for each in (dunes, later))
    match = [(np.roll(one, shift, axis=1) * other).sum() for shift in range(-6, 7)]
    assert np.argmax(match) - 6 > 0


def test_there_is_no_wind_below_a_crest() -> None:
    h = np.zeros((1, 100))
    h[0, 20] = 4.0
    length = int(4.0 / SHADOW)
    shadow = in_shadow(h)[0]
    assert shadow[21 : 20 + length].all()
    assert not shadow[20 + length + 1 :].any()
    assert not shadow[:21].any()


def test_the_same_seed_gives_the_same_dunes(dunes: np.ndarray) -> None:
    again = blow(np.full((64, 96), 3.0), np.random.default_rng(0), steps=300, hop=3, repose=REPOSE)
    assert np.array_equal(again, dunes)
