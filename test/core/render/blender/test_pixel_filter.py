"""The filter of denoised pictures: known pictures, and moments of the filters in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.render.blender.postprocessing import (
    CYCLES_WIDTH_PX,
    SAMPLED_WIDTH_PX,
    filter_denoised,
    filter_normal,
)

SIZE_PX = 9
MIDDLE = SIZE_PX // 2
MANY = 10**6
BLACKMAN_HARRIS = (0.35875, -0.48829, 0.14128, -0.01168)


def spread_px2(width_px: float) -> float:
    """The variance of Cycles' filter (Harris 1978, four terms) along one axis."""
    share = (np.arange(10_000) + 0.5) / 10_000
    weight = sum(term * np.cos(2 * np.pi * k * share) for k, term in enumerate(BLACKMAN_HARRIS))
    return float(np.average((2 * width_px * (share - 0.5)) ** 2, weights=weight))


def point() -> np.ndarray:
    light = np.zeros((SIZE_PX, SIZE_PX, 3), np.float32)
    light[MIDDLE, MIDDLE] = (1.0, 2.0, 4.0)
    return light


def test_even_light_stays_as_it_is_up_to_the_border() -> None:
    light = np.full((4, 5, 3), 0.7, np.float32)
    np.testing.assert_allclose(filter_denoised(light, 1), light, rtol=1e-6)


@pytest.mark.parametrize("samples", [1, 4, 64])
def test_light_is_shared_and_none_is_lost(samples: int) -> None:
    image = filter_denoised(point(), samples)
    np.testing.assert_allclose(image.sum((0, 1)), (1.0, 2.0, 4.0), rtol=1e-5)
    np.testing.assert_array_equal(image[..., 0], image[..., 0].T)
    np.testing.assert_array_equal(image, image[::-1])


def test_less_is_shared_where_texels_are_large_and_denoising_smears() -> None:
    kept = [filter_denoised(point(), n)[MIDDLE, MIDDLE, 0] for n in (1, 2, 7, 8, MANY)]
    assert kept == pytest.approx([0.84**2, 0.9**2, 0.9**2, 0.88**2, 0.87**2])


def test_less_is_shared_in_clutter_and_the_same_as_ever_of_many_samples() -> None:
    kept = [filter_denoised(point(), 3, clutter)[MIDDLE, MIDDLE, 0] for clutter in (0, 0.5, 1)]
    assert kept == sorted(kept)
    assert kept[-1] == pytest.approx(0.95**2)
    np.testing.assert_allclose(
        filter_denoised(point(), MANY, 1.0), filter_denoised(point(), MANY), atol=1e-5
    )


def test_of_many_samples_the_two_steps_filter_as_widely_as_cycles_alone() -> None:
    image = filter_denoised(point(), MANY)[..., 0]
    place_px = np.arange(SIZE_PX) - MIDDLE
    shared_px2 = np.average(place_px**2, weights=image.sum(axis=0))
    steps_px2 = spread_px2(SAMPLED_WIDTH_PX) + shared_px2
    assert steps_px2 == pytest.approx(spread_px2(CYCLES_WIDTH_PX), rel=0.05)


def test_rows_may_come_from_the_last_to_the_first() -> None:
    light = np.random.default_rng(1).random((6, 7, 3), np.float32)
    np.testing.assert_allclose(
        filter_denoised(light[::-1], 1), filter_denoised(light, 1)[::-1], rtol=1e-5
    )


def test_a_normal_is_shared_and_keeps_its_length_on_average() -> None:
    normal = filter_normal(point())
    assert normal[MIDDLE, MIDDLE, 0] == pytest.approx(0.84**2)
    np.testing.assert_allclose(normal.sum((0, 1)), (1.0, 2.0, 4.0), rtol=1e-5)
