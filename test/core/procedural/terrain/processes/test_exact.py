"""Functions with the same bits everywhere."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from oaisys_core.procedural.terrain.processes.exact import smooth


@pytest.mark.parametrize(("cells", "truncate"), [(0.6, 3.0), (1.0, 4.0), (7.3, 4.0)])
def test_smooth_is_the_gaussian_of_scipy(cells: float, truncate: float) -> None:
    values = np.random.default_rng(0).normal(size=(60, 60))
    expected = scipy.ndimage.gaussian_filter(values, cells, mode="nearest", truncate=truncate)
    np.testing.assert_allclose(smooth(values, cells, truncate), expected, atol=2e-9)


def test_smooth_has_known_bits() -> None:
    # The impulse shows the weights: exp of other libraries differs in its last bits.
    impulse = np.zeros((9, 9))
    impulse[4, 4] = 1.0
    weights = np.array([0.1353352832, 0.6065306597, 1.0, 0.6065306597, 0.1353352832])
    weights /= sum(weights.tolist())
    np.testing.assert_array_equal(smooth(impulse, 1.0, 2.0)[2:7, 4], weights * weights[2])
