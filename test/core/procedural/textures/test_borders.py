"""Borders between layers of the ground follow the relief of their textures."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from oaisys_core.procedural.textures.borders import (
    HEIGHT_VARIANCE,
    MAX_HEIGHT,
    MEAN_HEIGHT,
    MIN_HEIGHT,
    NEGLIGIBLE,
    Heights,
    borders,
    height_levels,
    keys,
    mix,
    relief_weights,
)
from oaisys_core.procedural.textures.levels import levels_of
from oaisys_core.scene.terrain_material import PbrMaps


def maps(height: NDArray[Any]) -> PbrMaps:
    size = len(height)
    plain = np.full((size, size, 3), 128, np.uint8)
    return PbrMaps("a", plain, height.astype(np.float32), plain, plain[..., 0], 2.0)


def heights(height: NDArray[Any]) -> list[Heights]:
    return height_levels(levels_of(maps(height)))


def decoded(found: Heights) -> NDArray[Any]:
    return MIN_HEIGHT + found.texels.ravel() * ((MAX_HEIGHT - MIN_HEIGHT) / 255)


def rough(seed: int) -> NDArray[Any]:
    return np.exp(np.random.default_rng(seed).normal(size=(256, 256)))


def seen(weights: tuple[float, ...], level: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return (N, L) weights of rough layers at a level, and the heights that they are seen by."""
    levels = [heights(rough(seed))[level] for seed in range(len(weights))]
    of_layers = np.stack([decoded(each) for each in levels], axis=1)
    variances = np.tile([each.variance for each in levels], (len(of_layers), 1))
    return relief_weights(np.tile(weights, (len(of_layers), 1)), of_layers, variances), of_layers


def test_heights_have_gumbels_distribution_and_the_order_of_the_texture() -> None:
    height = rough(1)
    finest, *coarser = heights(height)
    assert finest.variance == pytest.approx(HEIGHT_VARIANCE, rel=0.02)
    assert stats.kstest(decoded(finest), stats.gumbel_r.cdf).statistic < 0.02
    order = np.argsort(height, axis=None)
    assert (np.diff(finest.texels.ravel()[order].astype(int)) >= 0).all()
    assert all(one.variance > other.variance for one, other in pairwise((finest, *coarser)))
    (flat, *_) = heights(np.full((16, 16), 0.3))
    assert flat.variance == 0.0
    assert decoded(flat) == pytest.approx(MEAN_HEIGHT, abs=0.02)


@pytest.mark.parametrize("weight", [0.02, 0.1, 0.35, 0.5, 0.8, 0.98])
def test_a_layer_covers_as_much_as_its_mask_says_and_its_highest_parts_first(weight: float) -> None:
    found, of_layers = seen((1 - weight, weight), 0)
    factor, above = found[:, 1], of_layers[:, 1] - of_layers[:, 0]
    assert factor.mean() == pytest.approx(weight, abs=0.015)
    assert above[factor > 0.5].min() > above[factor < 0.5].max()
    assert ((factor > 0) & (factor < 1)).mean() < 0.25


@pytest.mark.parametrize(
    "weights",
    [(0.5, 0.3, 0.2), (0.2, 0.3, 0.5), (0.25, 0.25, 0.5), (0.1, 0.2, 0.3, 0.4), (1 / 6,) * 6],
)
@pytest.mark.parametrize("level", [0, 1, 2, 5])
def test_any_number_of_layers_cover_what_their_masks_say_at_every_level(
    weights: tuple[float, ...], level: int
) -> None:
    found, _ = seen(weights, level)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(found.mean(axis=0), weights, atol=0.03)


@pytest.mark.parametrize("variance", [0.0, 0.5, HEIGHT_VARIANCE])
@pytest.mark.parametrize("others", [1, 2, 5])
def test_one_layer_alone_is_seen_where_the_others_have_no_weight(
    variance: float, others: int
) -> None:
    rng = np.random.default_rng(2)
    of_layers = rng.uniform(MIN_HEIGHT, MAX_HEIGHT, (500, others + 1))
    variances = np.full(of_layers.shape, variance)
    for alone in range(others + 1):
        weights = np.full(of_layers.shape, NEGLIGIBLE)
        weights[:, alone] = 1 - others * NEGLIGIBLE
        found = relief_weights(weights, of_layers, variances)
        np.testing.assert_array_equal(found[:, alone], 1.0)


def test_flat_textures_blend_as_their_masks() -> None:
    weight = np.linspace(0, 1, 101).astype(np.float32)
    flat = np.full(101, MEAN_HEIGHT, np.float32)
    (border,) = borders([0.0, 0.0])
    factor, _ = mix(keys(flat, weight), keys(flat, 1 - weight), border)
    np.testing.assert_allclose(factor, weight, atol=0.02)
