"""Borders between layers of the ground follow the relief of their textures."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.textures.borders import (
    NEGLIGIBLE,
    RANK_VARIANCE,
    Ranks,
    blends,
    factors,
    follows_relief,
    rank_levels,
    relief_weights,
    rooted,
)
from oaisys_core.textures.levels import levels_of
from oaisys_core.world.terrain_material import PbrMaps, TerrainLayer, TerrainMaterial
from oaisys_core.world.tiling import stochastic_tiling


def maps(height: NDArray[Any]) -> PbrMaps:
    size = len(height)
    plain = np.full((size, size, 3), 128, np.uint8)
    return PbrMaps("a", plain, height.astype(np.float32), plain, plain[..., 0], 2.0)


def ranks(height: NDArray[Any]) -> list[Ranks]:
    return rank_levels(levels_of(maps(height)))


def mixed(share: float, above: NDArray[Any], blend: float) -> NDArray[Any]:
    """The mix factor of the second of two layers, which lies ``above`` the first by ranks."""
    of_share, of_rank, offset = factors(blend)
    return np.clip(share * of_share + above * of_rank + offset, 0, 1)


def rough(seed: int) -> NDArray[Any]:
    return np.exp(np.random.default_rng(seed).normal(size=(128, 128)))


def test_ranks_are_distributed_evenly_and_in_the_order_of_heights() -> None:
    height = rough(1)
    finest, *coarser = ranks(height)
    assert finest.variance == pytest.approx(RANK_VARIANCE, rel=0.01)
    order = np.argsort(height, axis=None)
    assert (np.diff(finest.texels.ravel()[order].astype(int)) >= 0).all()
    assert all(one.variance > other.variance for one, other in pairwise((finest, *coarser)))
    (flat, *_) = ranks(np.full((16, 16), 0.3))
    assert (flat.variance, *np.unique(flat.texels)) == (0.0, 128)


@pytest.mark.parametrize("weight", [0.02, 0.1, 0.35, 0.5, 0.8, 0.98])
def test_a_layer_covers_as_much_as_its_mask_says_and_its_highest_parts_first(weight: float) -> None:
    first, second = (ranks(rough(seed))[0] for seed in (1, 2))
    (blend,) = blends([first.variance, second.variance])
    above = second.texels / 255 - first.texels / 255
    share = float(rooted(np.array([1 - weight, weight], np.float32)[:, None, None])[1, 0, 0])
    factor = mixed(share, above, blend)
    assert factor.mean() == pytest.approx(weight, abs=0.015)
    assert above[factor > 0.5].min() > above[factor < 0.5].max()
    assert ((factor > 0) & (factor < 1)).mean() < 0.25


def test_weights_of_three_layers_sum_to_one_and_one_alone_is_seen() -> None:
    seen = np.stack([ranks(rough(seed))[0].texels.ravel() / 255 for seed in (1, 2, 3)], axis=1)
    variances = np.full(seen.shape, RANK_VARIANCE)
    weights = np.tile((0.5, 0.3, 0.2), (len(seen), 1))
    found = relief_weights(weights, seen, variances)
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    alone = np.tile((1.0, 0.0, 0.0), (len(seen), 1))
    np.testing.assert_array_equal(relief_weights(alone, seen, variances), alone)


@pytest.mark.parametrize("variance", [0.0, 0.03, RANK_VARIANCE])
def test_one_layer_alone_is_seen_where_the_other_has_no_share(variance: float) -> None:
    above = np.linspace(-1, 1, 201)
    (blend,) = blends([variance, variance])
    assert (mixed(NEGLIGIBLE, above, blend) == 0).all()
    assert mixed(1 - NEGLIGIBLE, above, blend) == pytest.approx(1)


def test_flat_textures_blend_as_widely_as_their_masks() -> None:
    shares = rooted(np.array([np.linspace(1, 0, 101), np.linspace(0, 1, 101)])[..., None])[1]
    (blend,) = blends([0.0, 0.0])
    factor = mixed(shares[:, 0], np.zeros(101), blend)
    np.testing.assert_allclose(factor, np.linspace(0, 1, 101), atol=0.11)


def test_materials_of_many_layers_or_lookups_are_blended_by_masks() -> None:
    plain = TerrainLayer("a", (1,), maps(np.eye(8)))
    shifted = replace(plain, tiling=stochastic_tiling(1.0, np.random.default_rng(1)))

    def follows(*layers: TerrainLayer) -> bool:
        masks = np.ones((len(layers), 2, 2), np.float32)
        return follows_relief(TerrainMaterial(layers, masks, (0.0, 0.0, 1.0, 1.0)))

    assert all((follows(plain, plain), follows(*[plain] * 6), follows(shifted, shifted)))
    assert not any((follows(plain), follows(*[plain] * 7), follows(shifted, shifted, plain)))
