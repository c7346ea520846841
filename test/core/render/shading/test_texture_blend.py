"""Blended lookups of a texture have the mean and the contrast of a single one."""

import numpy as np
import pytest

from oaisys_core.render.shading.texture_blend import (
    contrast_gain,
    mean_of_lookups,
    restore_contrast,
)


def test_blended_colours_keep_mean_and_contrast_and_the_rest_is_a_mean() -> None:
    rng = np.random.default_rng(1)
    parts = [rng.normal(0.5, 0.05, (100, 200, 4)).astype(np.float32) for _ in range(3)]
    weights = np.full((3, 100, 200), 1 / 3, np.float32)
    texel = mean_of_lookups(parts, weights)
    heights = texel[..., 3].copy()
    np.testing.assert_allclose(heights, np.mean(parts, axis=0)[..., 3], atol=1e-6)
    restore_contrast(texel, contrast_gain(weights), np.full(3, 0.5, np.float32))
    assert texel[..., :3].mean() == pytest.approx(0.5, abs=1e-3)
    assert texel[..., :3].std() == pytest.approx(0.05, rel=0.02)
    np.testing.assert_array_equal(texel[..., 3], heights)


def test_a_single_lookup_stays_as_it_is() -> None:
    part = np.array([[0.1, 0.2, 0.3, 0.9]], np.float32)
    weights = np.ones((1, 1), np.float32)
    assert contrast_gain(weights) == pytest.approx(1)
    np.testing.assert_array_equal(mean_of_lookups([part], weights), part)
