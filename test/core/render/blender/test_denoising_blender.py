"""Denoising: known pictures under known noise, and views against converged ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray

SHAPE = (48, 64, 3)
NOISE = 0.2
MARGIN_PX = 8


def two_halves() -> NDArray[np.float32]:
    image = np.full(SHAPE, 0.2, np.float32)
    image[:, SHAPE[1] // 2 :] = (0.7, 0.6, 0.5)
    return image


def error(image: NDArray[Any], truth: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean((image.astype(float) - truth) ** 2)))


@pytest.fixture(scope="module")
def denoised() -> dict[str, Any]:
    rng = np.random.default_rng(1)
    noisy = (two_halves() * rng.gamma(1 / NOISE**2, NOISE**2, SHAPE)).astype(np.float32)
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), SHAPE)
    found: dict[str, Any] = in_blender("denoising.denoised", noisy, normal)
    return found | {"noisy": noisy}


@pytest.mark.parametrize("effort", ["fast", "balanced", "thorough"])
def test_noise_goes_and_edges_stay(denoised: dict[str, Any], effort: str) -> None:
    truth, image = two_halves(), denoised[effort]
    assert image.shape == SHAPE
    assert image.dtype == np.float32
    assert error(image, truth) < 0.25 * error(denoised["noisy"], truth)
    middle = SHAPE[1] // 2
    step = image[:, middle].mean(axis=0) - image[:, middle - 1].mean(axis=0)
    # The edge is of light here, so nothing guides the denoiser.
    np.testing.assert_allclose(step, (0.5, 0.4, 0.3), atol=0.12)


@pytest.mark.parametrize("before", ["another", "another size", "cancelling"])
def test_pictures_before_leave_no_trace(denoised: dict[str, Any], before: str) -> None:
    np.testing.assert_array_equal(denoised[f"after {before}"], denoised["fast"])


def test_a_result_is_not_written_over_by_the_next_one(denoised: dict[str, Any]) -> None:
    assert error(denoised["dark"], 0.5 * two_halves()) < 0.05


def test_denoising_stops_where_the_picture_is_no_longer_wanted(denoised: dict[str, Any]) -> None:
    assert denoised["cancelled"] == "enough"


def test_normals_of_another_size_are_refused(denoised: dict[str, Any]) -> None:
    assert denoised["error"] == "normal: received (47, 64, 3) beside light (48, 64, 3)"


@pytest.mark.parametrize("effort", ["fast", "balanced", "thorough"])
def test_texture_under_noisy_light_stays_sharp(effort: str) -> None:
    rng = np.random.default_rng(2)
    # Texels of one pixel, the largest that levels of detail give.
    albedo = rng.uniform(0.05, 0.6, SHAPE).astype(np.float32)
    light = rng.gamma(1 / NOISE**2, NOISE**2, (*SHAPE[:2], 1)).astype(np.float32)
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), SHAPE)
    found = in_blender("denoising.of_passes", albedo * light, albedo, normal, effort)
    truth, noisy = (in_blender("denoising.filtered", each) for each in (albedo, albedo * light))
    assert error(found, truth) < 0.5 * error(noisy, truth)


def test_a_known_albedo_replaces_a_noisy_one_where_samples_confirm_it() -> None:
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.2, 0.4, SHAPE).astype(np.float32)
    noisy = (truth * rng.uniform(0.8, 1.2, SHAPE)).astype(np.float32)
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), SHAPE)
    half = SHAPE[1] // 2
    known = truth.copy()
    known[:, :half] *= 1.2
    alone, with_known = (
        in_blender("denoising.of_passes", noisy, noisy, normal, "fast", *more)
        for more in ((), (known,))
    )
    filtered = in_blender("denoising.filtered", truth)
    refused, confirmed = slice(None, half - MARGIN_PX), slice(half + MARGIN_PX, None)
    before, after = (
        error(found[:, confirmed], filtered[:, confirmed]) for found in (alone, with_known)
    )
    assert after < 0.5 * before
    before, after = (
        error(found[:, refused], filtered[:, refused]) for found in (alone, with_known)
    )
    assert after == pytest.approx(before, rel=0.05)


def test_texture_is_as_sharp_as_without_denoiser_at_many_samples() -> None:
    truth = np.random.default_rng(5).uniform(0.05, 0.6, SHAPE).astype(np.float32)
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), SHAPE)
    few, many = (
        error(
            in_blender("denoising.of_passes", truth, truth, normal, "thorough", None, samples),
            in_blender("denoising.filtered", truth, samples),
        )
        for samples in (8, 128)
    )
    assert many < 0.3 * few


def test_neither_sky_nor_black_ground_bleed_over_their_border() -> None:
    """The upper third is sky, the lower one black."""
    third = SHAPE[0] // 3
    albedo = np.full(SHAPE, 0.2, np.float32)
    albedo[:third] = albedo[2 * third :] = 0
    normal = np.zeros(SHAPE, np.float32)
    normal[third:, :, 2] = 1
    radiance = albedo.copy()
    radiance[:third] = 1.0
    # Pixels of which half is sky.
    albedo[third], normal[third], radiance[third] = 0.1, (0, 0, 0.5), 0.6
    found = in_blender("denoising.of_passes", radiance, albedo, normal, "fast")
    truth = in_blender("denoising.filtered", radiance)
    # The network's own margin is not even.
    np.testing.assert_allclose(
        found[:, MARGIN_PX:-MARGIN_PX], truth[:, MARGIN_PX:-MARGIN_PX], atol=0.06
    )
    np.testing.assert_allclose(found[2 * third + 2 :], 0.0, atol=0.002)


@pytest.mark.long
def test_views_come_nearer_to_converged_ones() -> None:
    found = in_blender("denoising.pictures")
    truth = found["converged"]
    assert error(found["denoised"], truth) < 0.75 * error(found["noisy"], truth)
    assert error(found["thorough"], truth) < error(found["denoised"], truth)
    assert error(found["again"], found["denoised"]) < 0.5
    assert error(found["by cycles"], found["denoised"]) < 0.5 * error(found["noisy"], truth)
