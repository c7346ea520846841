"""The heaviest layer of points, against weights interpolated at each of them."""

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.scene.heaviest_layers import UNCERTAIN, HeaviestLayers
from oaisys_core.types import FloatArray

EXTENT_M = (-3.0, 2.0, 5.0, 10.0)
SIZE = 24


def masks_of(layers: int, seed: int = 1) -> NDArray[np.float32]:
    """Patches with soft borders, a few of them texels wide."""
    rng = np.random.default_rng(seed)
    scores = np.repeat(np.repeat(rng.normal(size=(layers, 6, 6)), 4, axis=1), 4, axis=2)
    scores += 0.1 * rng.normal(size=scores.shape)
    weights = np.exp(3 * scores)
    return (weights / weights.sum(axis=0)).astype(np.float32)


def interpolated(masks: NDArray[np.float32], xy_m: FloatArray) -> FloatArray:
    """The (N, L) weights at points between the outermost texels, by the textbook's formula."""
    x0, y0, x1, y1 = EXTENT_M
    column = (xy_m[:, 0] - x0) / (x1 - x0) * SIZE - 0.5
    row = (xy_m[:, 1] - y0) / (y1 - y0) * SIZE - 0.5
    c, r = np.floor(column).astype(int), np.floor(row).astype(int)
    s, t = column - c, row - r
    lower = masks[:, r, c] * (1 - s) + masks[:, r, c + 1] * s
    upper = masks[:, r + 1, c] * (1 - s) + masks[:, r + 1, c + 1] * s
    return np.asarray((lower * (1 - t) + upper * t).T)


@pytest.mark.parametrize("layers", [2, 4])
def test_certain_layers_are_the_heaviest(layers: int) -> None:
    masks = masks_of(layers)
    texel_m = 8.0 / SIZE
    rng = np.random.default_rng(2)
    low, high = np.array(EXTENT_M[:2]) + texel_m, np.array(EXTENT_M[2:]) - texel_m
    xy_m = rng.uniform(low, high, (20_000, 2))
    found = HeaviestLayers(masks, EXTENT_M).at(xy_m)
    certain = found != UNCERTAIN
    expected = interpolated(masks, xy_m).argmax(axis=1)
    np.testing.assert_array_equal(found[certain], expected[certain])
    assert 0.3 < certain.mean() < 1
    assert len(np.unique(found[certain])) == layers


def test_weights_decide_where_layers_are_tied_and_outside() -> None:
    tied = np.full((2, SIZE, SIZE), 0.5, np.float32)
    inside = np.array([(1.0, 6.0)])
    assert HeaviestLayers(tied, EXTENT_M).at(inside)[0] == UNCERTAIN
    tied[1] = 0.4
    heaviest = HeaviestLayers(tied, EXTENT_M)
    assert heaviest.at(inside)[0] == 0
    places = [(-3.1, 6.0), (5.1, 6.0), (1.0, 1.9), (1.0, 10.1), (np.nan, 6.0), (1.0, np.inf)]
    np.testing.assert_array_equal(heaviest.at(np.array(places)), UNCERTAIN)
    # As the masks' outermost texels, their outer halves have the weights of their middles.
    edges = np.array([(-3.0, 2.0), (5.0, 10.0), (-3.0, 10.0)])
    np.testing.assert_array_equal(heaviest.at(edges), 0)


def test_no_points_have_no_layers() -> None:
    assert len(HeaviestLayers(masks_of(3), EXTENT_M).at(np.zeros((0, 2)))) == 0
