"""Fields that textures are made of."""

import numpy as np
import pytest
from scipy import stats

from oaisys_core.procedural.textures import fields

SIZE = 256


def test_waves_in_a_narrow_band_have_their_length_and_direction() -> None:
    phase, amplitude = fields.narrow_band(SIZE, 20, np.random.default_rng(0), (0.05, 0.1))
    assert amplitude.mean() == pytest.approx(1, abs=1e-4)
    power = np.abs(np.fft.fft2(amplitude * np.exp(1j * phase))) ** 2
    along = np.fft.fftfreq(SIZE, 1 / SIZE)
    mean = (power.sum(axis=0) @ along / power.sum(), power.sum(axis=1) @ along / power.sum())
    assert mean == pytest.approx((20, 0), abs=0.5)


def test_waves_in_a_narrow_band_fork() -> None:
    phase, _ = fields.narrow_band(SIZE, 20, np.random.default_rng(1), (0.08, 0.15))
    # Around a crest's end the phase winds once: count these points by summing around each pixel.
    corners = (
        phase,
        np.roll(phase, -1, 1),
        np.roll(phase, (-1, -1), (0, 1)),
        np.roll(phase, -1, 0),
    )
    winding = sum(
        np.angle(np.exp(1j * (b - a)))
        for a, b in zip(corners, (*corners[1:], corners[0]), strict=True)
    )
    turns = np.rint(winding / (2 * np.pi))
    assert 2 <= np.abs(turns).sum() < 60
    # On a torus as many turn one way as the other.
    assert turns.sum() == 0


def test_windblown_noise_is_drawn_out_along_rows() -> None:
    field = fields.windblown(SIZE, np.random.default_rng(2), (3.0, 12.0), 2.0)
    assert field.std() == pytest.approx(1, abs=1e-3)
    along, across = (np.abs(np.diff(field, axis=axis)).mean() for axis in (1, 0))
    assert across > 2.5 * along


def test_domes_are_half_spheres_around_the_tile() -> None:
    centre, radius = np.array([[2.0, 100.5], [128.0, 128.0]]), np.array([10.0, 20.0])
    height = fields.domes(SIZE, centre, radius)
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    expected = np.zeros((SIZE, SIZE))
    for (row, column), r in zip(centre, radius, strict=True):
        down, right = ((d + SIZE / 2) % SIZE - SIZE / 2 for d in (y - row, x - column))
        expected = np.maximum(expected, np.sqrt(np.maximum(r**2 - down**2 - right**2, 0)))
    assert np.allclose(height, expected, atol=1e-3)


def test_sizes_follow_a_truncated_power_law() -> None:
    low, high, exponent = 0.01, 0.2, 1.7
    _, radius = fields.spread(SIZE, 4000, (low, high), exponent, np.random.default_rng(3))

    def share_below(r: np.ndarray) -> np.ndarray:
        return np.asarray((1 - (r / low) ** -exponent) / (1 - (high / low) ** -exponent))

    assert stats.kstest(radius / SIZE, share_below).pvalue > 0.01


def test_density_keeps_what_falls_where_it_is_high() -> None:
    density = np.zeros((SIZE, SIZE), np.float32)
    density[:, : SIZE // 2] = 1
    centre, radius = fields.spread(SIZE, 1000, (0.01, 0.1), 2.0, np.random.default_rng(4), density)
    assert len(centre) == len(radius)
    assert 400 < len(centre) < 600
    assert (centre[:, 1] < SIZE // 2).all()
