"""The octaves of the land's relief at points of different spacing."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.procedural.terrain.surroundings.octaves import Shaper, octave_heights
from oaisys_core.procedural.terrain.surroundings.spectrum import Octave
from oaisys_core.types import FloatArray

OCTAVES = [Octave(4.0 * 2**index, 0.05 * 2**index) for index in range(7)]


def heights(xy_m: FloatArray, spacing_m: FloatArray, shaped_by: Shaper) -> dict[float, FloatArray]:
    """Return the (N,) heights of each octave by its wavelength, NaN where it has none."""
    rngs = [np.random.default_rng(index) for index in range(len(OCTAVES))]
    found = {}
    for octave, here, height_m in octave_heights(xy_m, spacing_m, OCTAVES, rngs, shaped_by):
        whole_m = np.full(len(xy_m), np.nan)
        whole_m[here] = height_m
        found[octave.wavelength_m] = whole_m
    return found


@pytest.mark.parametrize("shaped_by", ["water", "impacts", "wind"])
def test_heights_do_not_depend_on_the_order_of_the_points(shaped_by: Shaper) -> None:
    rng = np.random.default_rng(3)
    xy_m = rng.uniform(-200.0, 200.0, (3000, 2))
    spacing_m = np.sort(rng.uniform(0.3, 9.0, len(xy_m)))
    shuffled = rng.permutation(len(xy_m))
    in_order = heights(xy_m, spacing_m, shaped_by)
    anyhow = heights(xy_m[shuffled], spacing_m[shuffled], shaped_by)
    assert in_order.keys() == anyhow.keys() == {octave.wavelength_m for octave in OCTAVES}
    for wavelength_m, height_m in in_order.items():
        np.testing.assert_allclose(anyhow[wavelength_m], height_m[shuffled], atol=1e-9)


def test_octaves_are_left_out_where_points_are_too_far_apart() -> None:
    xy_m = np.random.default_rng(4).uniform(-200.0, 200.0, (500, 2))
    spacing_m = np.full(len(xy_m), 5.0)
    found = heights(xy_m, spacing_m, "wind")
    assert min(found) == 16.0, "two points in a wave are too few"
    assert all(np.isfinite(height_m).all() for height_m in found.values())
    assert found[64.0].std() == pytest.approx(0.8, rel=0.4)
