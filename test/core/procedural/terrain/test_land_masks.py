"""Layers on the land around a stage: what the stage has, in patches of many sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_worlds import texture

from oaisys_core.procedural.terrain.masks.patches import blend_masks
from oaisys_core.procedural.terrain.surroundings.land_masks import PatchyLandMasks
from oaisys_core.scene import TerrainLayer, TerrainMaterial
from oaisys_core.verification.reference_scene import ground_labels

HALF_M = 32.0
EXTENT_M = (-HALF_M, -HALF_M, HALF_M, HALF_M)
PATCH_M = 9.0
WIDE_M = 1024.0


def material(seed: int = 4, count: int = 2) -> TerrainMaterial:
    masks = blend_masks(count, 64.0, 256, np.random.default_rng(1), PATCH_M, 0.75)
    shares = tuple(masks.mean(axis=(1, 2), dtype=np.float64).tolist())
    maps = texture("any", (90, 90, 90), 2.0)
    layers = tuple(TerrainLayer(str(index), (index + 1,), maps) for index in range(count))
    land = PatchyLandMasks(EXTENT_M, shares, PATCH_M, 0.076, seed)
    return TerrainMaterial(layers, masks, EXTENT_M, land=land)


@pytest.fixture(scope="module")
def with_land() -> TerrainMaterial:
    return material()


def square(start_m: float, step_m: float, count: int) -> NDArray[np.float64]:
    """(count**2, 2) points of a grid beyond the stage."""
    axis = start_m + step_m * np.arange(count)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def test_the_stage_keeps_its_weights_and_labels(with_land: TerrainMaterial) -> None:
    alone = replace(with_land, land=None)
    inside_m = np.random.default_rng(0).uniform(-HALF_M, HALF_M, (5000, 2))
    corners_m = np.array([(x, y) for x in (-HALF_M, HALF_M) for y in (-HALF_M, HALF_M)])
    xy_m = np.concatenate((inside_m, corners_m, 3 * corners_m))
    on_stage = slice(0, len(inside_m) + 4)
    found = with_land.weights_at(xy_m)[on_stage]
    assert found.tobytes() == alone.weights_at(xy_m)[on_stage].tobytes()
    labels = with_land.semantic_ids_at(xy_m)[on_stage]
    assert labels.tobytes() == alone.semantic_ids_at(xy_m)[on_stage].tobytes()


def test_the_stage_goes_on_without_a_seam(with_land: TerrainMaterial) -> None:
    along_m = np.linspace(-HALF_M, HALF_M, 400)
    edge_m = np.column_stack((np.full_like(along_m, HALF_M), along_m))
    inside, outside = (
        with_land.weights_at(edge_m + np.array((step_m, 0))) for step_m in (-1e-3, 1e-3)
    )
    assert np.abs(outside - inside).max() < 0.01
    assert np.abs(with_land.weights_at(edge_m + np.array((PATCH_M, 0))) - inside).mean() > 0.1


def test_land_is_drawn_from_the_seed_alone(with_land: TerrainMaterial) -> None:
    weights = [each.land.weights for each in (with_land, material(), material(5)) if each.land]
    assert weights[0].tobytes() == weights[1].tobytes()
    assert (weights[0].argmax(axis=0) != weights[2].argmax(axis=0)).mean() > 0.3


@pytest.mark.parametrize("count", [2, 3])
def test_land_has_the_shares_of_the_stage(count: int) -> None:
    land = material(count=count).land
    assert isinstance(land, PatchyLandMasks)
    np.testing.assert_allclose(land.weights.sum(axis=0), 1, atol=1e-5)
    won = np.bincount(land.weights.argmax(axis=0).ravel()) / land.weights[0].size
    np.testing.assert_allclose(won, land.shares, atol=0.05)


def test_patches_are_of_many_sizes_and_do_not_repeat(with_land: TerrainMaterial) -> None:
    """Unlike the mirrored masks, which are the same in every square of twice the stage's edge."""
    xy_m = square(50.0, 4.0, 256)
    shares, peaks = [], []
    for each in (with_land, replace(with_land, land=None)):
        sand = (each.semantic_ids_at(xy_m) == 2).reshape(256, 256).astype(float)
        shares.append(sand.reshape(8, 32, 8, 32).mean(axis=(1, 3)).std())
        peaks.append(repetition(sand))
    assert shares[0] > 0.12
    assert shares[1] < 0.01
    assert peaks[0] < 0.3
    assert peaks[1] > 0.4, peaks


def repetition(image: NDArray[np.float64]) -> float:
    """The highest peak of the autocorrelation that is no slope of its centre."""
    from scipy.ndimage import maximum_filter

    window = np.hanning(len(image))[:, None] * np.hanning(len(image))
    power = np.abs(np.fft.fft2((image - image.mean()) * window, s=(512, 512))) ** 2
    overlap = np.fft.ifft2(np.abs(np.fft.fft2(window, s=(512, 512))) ** 2).real
    found = np.fft.ifft2(power).real / np.maximum(overlap, 0.1 * overlap.max())
    found = np.fft.fftshift(found / found[0, 0])[128:385, 128:385]
    away = np.hypot(*np.indices(found.shape) - 128) > 16
    is_peak = (found == maximum_filter(found, 15)) & away
    return float(found[is_peak].max())


def test_the_audits_own_caster_finds_the_same_layers(with_land: TerrainMaterial) -> None:
    rng = np.random.default_rng(2)
    turn, distance_m = rng.uniform(0, 2 * np.pi, 20_000), 30 * np.exp(rng.uniform(0, 7, 20_000))
    xy_m = np.column_stack((distance_m * np.cos(turn), distance_m * np.sin(turn)))
    by_audit = ground_labels(with_land, xy_m, 0)
    assert (by_audit == with_land.semantic_ids_at(xy_m)).mean() > 0.9995
