"""What wind makes: tails behind edges, sheets that it left, ripples."""

import numpy as np
import pytest

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures.baking.wind import Sheet, carve, ripples, swerve, tails

SIZE, WAVES, FALL = 256, 16, 0.05


@pytest.fixture(scope="module")
def wave() -> Field:
    return ripples(SIZE, WAVES, np.random.default_rng(2))


def steps(field: Field) -> Field:
    """How much higher the next texel with the wind is, around the tile."""
    return np.roll(field, -1, axis=1) - field


def test_a_tail_falls_evenly_behind_what_stands_and_around_the_tile() -> None:
    height = np.zeros((SIZE, SIZE), np.float32)
    height[3, SIZE - 20] = 0.01
    behind = np.roll(tails(height, FALL)[3], 20)
    assert np.allclose(behind, np.maximum(0.01 - FALL * np.arange(SIZE) / SIZE, 0), atol=1e-7)
    assert not np.delete(tails(height, FALL), 3, axis=0).any()


def test_tails_are_the_lowest_surface_that_falls_gently() -> None:
    height = np.random.default_rng(1).uniform(0, 0.1, (SIZE, SIZE)).astype(np.float32)
    filled = tails(height, FALL)
    assert (filled >= height).all()
    assert steps(filled).min() > -FALL / SIZE - 1e-6
    # Whatever is higher than what stood there continues the tail before it.
    raised = filled > height
    assert np.allclose(steps(np.roll(filled, 1, axis=1))[raised], -FALL / SIZE, atol=1e-6)


def test_what_is_hard_stays_as_thick_as_said() -> None:
    hardness = np.full((SIZE, SIZE), -1, np.float32)
    hardness[100:140, 100:140] = 2.0
    left = carve(hardness, [Sheet(0.0, 0.02, 0.01), Sheet(1.0, 0.03, 0.0)], FALL, 4.0)
    assert np.allclose(left[110:130, 110:130] * 4.0, 0.02 + 0.01 * 2 + 0.03, atol=1e-6)
    windward, lee = steps(left)[120].max(), -steps(left)[120].min()
    # The blur of the tails takes a little of the edge.
    assert windward > 0.85 * 0.07 / 4.0
    assert lee < 0.3 * windward


def test_rows_swerve_as_far_as_said() -> None:
    line = np.zeros((SIZE, SIZE), np.float32)
    line[SIZE // 2] = 1.0
    assert (swerve(line, 2, 0.0, np.random.default_rng(0)) == line).all()
    bent = swerve(line, 2, 0.02, np.random.default_rng(0))
    away = (bent * np.arange(SIZE)[:, None]).sum(axis=0) / bent.sum(axis=0) - SIZE / 2
    assert 0.01 < away.std() / SIZE < 0.03


def test_ripples_are_as_long_as_said_and_fork(wave: Field) -> None:
    crests = ((wave < 0) & (np.roll(wave, -1, axis=1) >= 0)).sum(axis=1)
    assert crests.mean() == pytest.approx(WAVES, rel=0.08)
    # A crest that ends or forks is in some rows only.
    assert np.ptp(crests) >= 2


def test_ripples_are_equally_high_and_steep_in_the_lee(wave: Field) -> None:
    highest = wave.reshape(SIZE, 4, SIZE // 4).max(axis=(0, 2))
    assert np.ptp(highest) < 0.25
    assert -np.quantile(steps(wave), 0.02) > 1.25 * np.quantile(steps(wave), 0.98)


def test_a_seed_decides_about_ripples(wave: Field) -> None:
    again, other = (ripples(SIZE, WAVES, np.random.default_rng(seed)) for seed in (2, 3))
    assert (again == wave).all()
    assert abs(np.corrcoef(other.ravel(), wave.ravel())[0, 1]) < 0.3
