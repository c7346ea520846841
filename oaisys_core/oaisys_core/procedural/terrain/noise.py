"""Noise fields: gradient noise, fractal sums of it, and spectral noise.

Gradient noise is after Perlin, "Improving noise", SIGGRAPH 2002: random gradients on an integer
lattice, blended with the quintic 6t^5 - 15t^4 + 10t^3. Spectral noise is after Saupe, in "The
Science of Fractal Images", 1988.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

Field = NDArray[np.float32]
Coordinates = FloatArray | Field

LATTICE = 256
"""Period, in cells, of noise that need not tile; larger than any ground."""

BLOCK = 32768
"""Points that a thread processes at once, so that intermediate arrays fit into the CPU cache."""

OFFSET_STEPS, OFFSET_GAIN = 60, 0.5
"""Search for the offsets that give scores their shares: steps and step size."""


def gradient_noise(
    x: Coordinates, y: Coordinates, rng: np.random.Generator, period: int = LATTICE
) -> Field:
    """Return noise of about -1 to 1 at lattice coordinates; it repeats after ``period`` cells.

    A regular grid should be given as a (1, C) row and an (R, 1) column, see `grid`. The result is
    the same, but terms that depend on one axis only are computed once.

    Args:
        x, y: Coordinates with broadcastable shapes, in lattice cells.
        rng: Draws the gradients.
        period: Size of the lattice; a field over 0 to ``period`` tiles.
    """
    angle = rng.uniform(0, 2 * np.pi, period * period)
    gradients = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    if x.ndim == y.ndim == 2 and len(x) == 1 and y.shape[1] == 1:
        return _noise_of_grid(x[0], y[:, 0], gradients, period)
    x, y = np.broadcast_arrays(x, y)
    shape, x, y = x.shape, x.ravel(), y.ravel()
    total = np.empty(x.shape, np.float32)

    def fill(block: slice) -> None:
        total[block] = _noise_of_points(x[block], y[block], gradients, period)

    _in_blocks(fill, len(x), BLOCK)
    return total.reshape(shape)


def _in_blocks(fill: Callable[[slice], None], count: int, step: int) -> None:
    """Call ``fill`` for blocks of ``step`` out of ``count``, on all processors."""
    blocks = [slice(first, first + step) for first in range(0, count, step)]
    if len(blocks) == 1:
        fill(blocks[0])
        return
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(fill, blocks))


class _Places(NamedTuple):
    """Lattice coordinates along one axis: the cell, and the position within it.

    Attributes:
        cell, next_cell: (N,) int64 indices of the cell and the next one.
        share, share_left: (N,) float32 distance from the lower corner, and from the upper one.
        fade: (N,) float32 weight of the upper corner.
    """

    cell: NDArray[np.int64]
    next_cell: NDArray[np.int64]
    share: Field
    share_left: Field
    fade: Field


def _places(x: Coordinates, period: int) -> _Places:
    low = np.floor(x)
    share = (x - low).astype(np.float32)
    cell = low.astype(np.int64)
    if period & (period - 1):
        cell %= period
    else:
        # The same for a power of two, but faster.
        cell &= period - 1
    after = cell + 1
    after[after == period] = 0
    return _Places(cell, after, share, share - 1, _fade(share))


def _noise_of_points(
    x: Coordinates, y: Coordinates, gradients: tuple[Field, Field], period: int
) -> Field:
    """Return the noise at (N,) points."""
    u, v = _places(x, period), _places(y, period)

    def corner(rows: NDArray[np.int64], cells: NDArray[np.int64], ds: Field, dt: Field) -> Field:
        index = rows + cells
        result = gradients[0].take(index, mode="clip")
        result *= ds
        part = gradients[1].take(index, mode="clip")
        part *= dt
        result += part
        return result

    def along(rows: NDArray[np.int64], dt: Field) -> Field:
        left = corner(rows, u.cell, u.share, dt)
        right = corner(rows, u.next_cell, u.share_left, dt)
        return _blend(left, right, u.fade)

    low = along(v.cell * period, v.share)
    high = along(v.next_cell * period, v.share_left)
    return _blend(low, high, v.fade) * np.float32(np.sqrt(2))


def _noise_of_grid(
    x: Coordinates, y: Coordinates, gradients: tuple[Field, Field], period: int
) -> Field:
    """Return the (R, C) noise at all pairs of (C,) x and (R,) y."""
    u, v = _places(x, period), _places(y, period)
    across, upward = (part.reshape(period, period) for part in gradients)
    total = np.empty((len(y), len(x)), np.float32)

    def fill(block: slice) -> None:
        # The lattice rows in this block, and their gradients at the columns of the grid.
        used, place = np.unique((v.cell[block], v.next_cell[block]), return_inverse=True)
        row, next_row = place.reshape(2, -1)
        a, b = across[used], upward[used]
        left = a.take(u.cell, axis=1) * u.share, b.take(u.cell, axis=1)
        right = a.take(u.next_cell, axis=1) * u.share_left, b.take(u.next_cell, axis=1)

        def along(rows: NDArray[np.intp], dt: Field) -> Field:
            ends = []
            for start, rise in (left, right):
                end = rise.take(rows, axis=0)
                end *= dt
                end += start.take(rows, axis=0)
                ends.append(end)
            return _blend(ends[0], ends[1], u.fade)

        low = along(row, v.share[block, None])
        high = along(next_row, v.share_left[block, None])
        np.multiply(
            _blend(low, high, v.fade[block, None]), np.float32(np.sqrt(2)), out=total[block]
        )

    _in_blocks(fill, len(y), max(1, BLOCK // len(x)))
    return total


def _blend(low: Field, high: Field, share: Field) -> Field:
    """Return ``low + (high - low) * share``; overwrites ``low`` and ``high``."""
    high -= low
    high *= share
    low += high
    return low


def _fade(t: Field) -> Field:
    return np.asarray(t * t * t * (t * (t * 6 - 15) + 10), np.float32)


def fractal(
    x: Coordinates,
    y: Coordinates,
    rng: np.random.Generator,
    *,
    octaves: int,
    gain: float = 0.5,
    kind: str = "fbm",
    period: int | None = None,
) -> Field:
    """Return the sum of octaves of noise, each with twice the frequency and ``gain`` the amplitude.

    Args:
        x, y: Lattice coordinates of the first octave.
        rng: Draws the gradients of every octave.
        octaves: Number of octaves.
        gain: Amplitude of each octave relative to the one before.
        kind: ``fbm`` (-1 to 1), ``billow`` (rounded lumps, 0 to 1) or ``ridged`` (crests, 0 to 1).
        period: Period of the field in cells of the first octave; None if it need not tile.
    """
    total = np.zeros(np.broadcast(x, y).shape, np.float32)
    amplitude, norm = 1.0, 0.0
    for octave in range(octaves):
        scale = 2**octave
        noise = gradient_noise(x * scale, y * scale, rng, period * scale if period else LATTICE)
        if kind == "billow":
            noise = np.abs(noise)
        elif kind == "ridged":
            noise = np.square(1 - np.minimum(np.abs(noise), 1))
        total += np.float32(amplitude) * noise
        norm += amplitude
        amplitude *= gain
    return total / np.float32(norm)


def warp(
    x: FloatArray,
    y: FloatArray,
    rng: np.random.Generator,
    strength: float,
    octaves: int = 3,
) -> tuple[FloatArray, FloatArray]:
    """Return coordinates displaced by noise (domain warping), by up to about ``strength`` cells."""
    dx = fractal(x, y, rng, octaves=octaves)
    dy = fractal(x, y, rng, octaves=octaves)
    return x + strength * dx, y + strength * dy


def grid(extent: float, size: int, cell: float) -> tuple[FloatArray, FloatArray]:
    """Return lattice coordinates of a square with edge ``extent`` and cells ``cell`` wide.

    They are a (1, size) row x and a (size, 1) column y, which broadcast to the square.
    """
    axis = np.linspace(0.0, extent / cell, size)
    return axis[None, :], axis[:, None]


def spectral(size: int, lowest: float, rng: np.random.Generator, rough: float) -> Field:
    """Return (size, size) tileable fractal noise with standard deviation 1.

    Args:
        size: Edge length.
        lowest: Frequency of the largest features, in waves per edge.
        rng: Draws the white noise that is filtered.
        rough: Exponent by which amplitudes fall with frequency: 1.4 is crumbly, 2.5 smooth.
    """
    frequency = np.hypot(
        scipy.fft.fftfreq(size, 1 / size)[:, None], scipy.fft.rfftfreq(size, 1 / size)[None, :]
    ).astype(np.float32)
    relative = frequency / np.float32(lowest)
    # Fade out below the lowest frequency, because a sharp cut-off would cause ringing.
    gain = np.where(relative >= 1, np.maximum(relative, 1) ** np.float32(-rough), relative**4)
    gain[0, 0] = 0
    return filter_noise(size, gain, rng)


def band(size: int, lowest: float, highest: float, rng: np.random.Generator) -> Field:
    """Return (size, size) tileable noise with standard deviation 1, in a band of frequencies.

    Every octave of the band has the same variance.

    Args:
        size: Edge length.
        lowest, highest: Bounds, in waves per edge.
        rng: Draws the white noise that is filtered.
    """
    frequency = np.hypot(
        scipy.fft.fftfreq(size, 1 / size)[:, None], scipy.fft.rfftfreq(size, 1 / size)[None, :]
    ).astype(np.float32)
    inside = (frequency >= lowest) & (frequency <= highest) & (frequency > 0)
    gain = np.where(inside, 1 / np.maximum(frequency, 1e-9), 0)
    return filter_noise(size, np.asarray(gain, np.float32), rng)


def filter_noise(size: int, gain: Field, rng: np.random.Generator) -> Field:
    """Return (size, size) tileable noise with standard deviation 1.

    Args:
        size: Edge length.
        gain: (size, size // 2 + 1) amplitudes, in the order of frequencies of a real transform.
        rng: Draws the white noise that is filtered.
    """
    white = rng.standard_normal((size, size), dtype=np.float32)
    field = scipy.fft.irfft2(scipy.fft.rfft2(white) * gain, s=white.shape)
    return np.asarray(field / (field.std() + 1e-12), np.float32)


def balancing_offsets(scores: Field, shares: FloatArray) -> Field:
    """Return (L,) offsets with which each of (L, R, C) scores is the highest on its share."""
    wanted = np.log(np.asarray(shares) / sum(shares))
    few = scores.reshape(len(scores), -1)
    offsets = np.zeros(len(scores), np.float32)
    for _ in range(OFFSET_STEPS):
        winner = (few + offsets[:, None]).argmax(axis=0)
        count = np.maximum(np.bincount(winner, minlength=len(scores)), 1)
        offsets += (OFFSET_GAIN * (wanted - np.log(count / few.shape[1]))).astype(np.float32)
    return offsets
