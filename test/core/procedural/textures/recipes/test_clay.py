"""Cracked clay: plates as large as said, cracks that divide them one after another."""

import itertools

import numpy as np
import pytest

from oaisys_core.procedural.textures import cells
from oaisys_core.procedural.textures.cells import Ids
from oaisys_core.procedural.textures.recipes import clay
from oaisys_core.procedural.textures.recipes.finish import TextureMaps

SIZE = 512


@pytest.fixture(scope="module")
def ages() -> list[Ids]:
    return clay.divide(SIZE, np.random.default_rng(2))


@pytest.fixture(scope="module")
def made() -> TextureMaps:
    return clay.clay_cracks(SIZE, np.random.default_rng(2))


def roots_m(ids: Ids) -> np.ndarray:
    """Roots of the areas of plates."""
    return np.asarray(np.sqrt(np.bincount(ids.ravel())) * clay.TILE_M / len(ids))


def test_later_cracks_divide_what_earlier_ones_left(ages: list[Ids]) -> None:
    for older, younger in itertools.pairwise(ages):
        assert younger.max() > 2 * older.max()
        pairs = np.unique(younger.astype(np.int64) * 10**6 + older)
        assert len(pairs) == younger.max() + 1


def test_plates_are_as_large_as_said(ages: list[Ids]) -> None:
    """Smaller than the largest that is left, and few smaller than half of the smallest."""
    size_m = roots_m(ages[-1])
    low, high = clay.LEAST_M
    assert size_m.max() <= high
    assert np.average(size_m, weights=size_m**2) > low
    assert (size_m**2)[size_m < low / 2].sum() < 0.05 * (size_m**2).sum()


def test_a_long_plate_is_halved_across() -> None:
    row, column = np.mgrid[:SIZE, :SIZE]
    long = (row // (SIZE // 4)) * 2 + column // (SIZE // 2)
    straight = [np.zeros((SIZE, SIZE), np.float32)] * 2
    halves = clay.halve(long, straight, np.zeros(8), np.random.default_rng(0))
    assert halves.max() == 15
    share = np.bincount(halves.ravel()) / (SIZE**2 / 16)
    assert (np.abs(share - 1) < 0.5).all()
    x, y = cells.from_centre(halves)
    # Across the longer side: all pieces are as high as the plate was.
    for number in range(16):
        of_piece = halves == number
        assert np.isclose(np.ptp(y[of_piece]) * SIZE, SIZE // 4, atol=2)
        assert np.ptp(x[of_piece]) < 0.45


def test_small_plates_stay(ages: list[Ids]) -> None:
    straight = [np.zeros((SIZE, SIZE), np.float32)] * 2
    least = np.full(ages[1].max() + 1, 1.0)
    after = clay.halve(ages[1], straight, least, np.random.default_rng(0))
    assert np.array_equal(after, ages[1])


def test_cracks_are_deep_and_rims_are_curled(made: TextureMaps, ages: list[Ids]) -> None:
    plates = clay.divide(SIZE // 2, np.random.default_rng(2))[-1]
    away_m = cells.border_distance(plates) * clay.TILE_M / len(plates)
    height_m = made.height.reshape(SIZE // 2, 2, SIZE // 2, 2).mean(axis=(1, 3)) * clay.TILE_M
    middle = np.median(height_m[away_m > 0.045])
    rim = np.median(height_m[(away_m > 0.010) & (away_m < 0.016)])
    assert 0.001 < rim - middle < clay.CURL_M
    assert middle - np.median(height_m[away_m == 0]) > 0.003
    dark = made.color.mean(axis=-1) < 0.6 * np.median(made.color.mean(axis=-1))
    assert 0.01 < dark.mean() < 0.25
