"""Noise fields on square grids, drawn from a generator that is passed in.

Gradient noise is after Perlin, "Improving noise", SIGGRAPH 2002: random gradients on an integer
lattice, blended with the quintic 6t^5 - 15t^4 + 10t^3. Spectral noise is after Saupe, in "The
Science of Fractal Images", 1988.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

Field = NDArray[np.float32]
Coordinates = FloatArray | Field

LATTICE = 256
"""Cells after which noise repeats that need not tile: more than any ground has."""

BLOCK = 32768
"""Points that are worked on at once, by one thread: their arrays stay in the processor's cache."""


def gradient_noise(
    x: Coordinates, y: Coordinates, rng: np.random.Generator, period: int = LATTICE
) -> Field:
    """Return noise of about -1 to 1 at lattice coordinates; it repeats after ``period`` cells.

    Args:
        x, y: Coordinates of one shape; one lattice cell is 1 wide.
        rng: Gives the gradients.
        period: Lattice size; a field over 0..period is tileable.
    """
    angle = rng.uniform(0, 2 * np.pi, period * period)
    gradients = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    x, y = np.broadcast_arrays(x, y)
    shape, x, y = x.shape, x.ravel(), y.ravel()
    total = np.empty(x.shape, np.float32)

    def fill(first: int) -> None:
        block = slice(first, first + BLOCK)
        total[block] = _noise_of_block(x[block], y[block], gradients, period)

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(fill, range(0, len(x), BLOCK)))
    return total.reshape(shape)


def _noise_of_block(
    x: Coordinates, y: Coordinates, gradients: tuple[Field, Field], period: int
) -> Field:
    """Return the noise at (N,) coordinates."""
    column, row = np.floor(x), np.floor(y)
    s, t = (x - column).astype(np.float32), (y - row).astype(np.float32)
    c0, r0 = column.astype(np.int64) % period, row.astype(np.int64) % period
    c1, r1 = (c0 + 1) % period, (r0 + 1) % period

    def corner(r: NDArray[np.int64], c: NDArray[np.int64], ds: Field, dt: Field) -> Field:
        cell = r * period + c
        return np.asarray(gradients[0].take(cell) * ds + gradients[1].take(cell) * dt)

    u, v = _fade(s), _fade(t)
    low = corner(r0, c0, s, t)
    low += u * (corner(r0, c1, s - 1, t) - low)
    high = corner(r1, c0, s, t - 1)
    high += u * (corner(r1, c1, s - 1, t - 1) - high)
    low += v * (high - low)
    return np.asarray(low * np.float32(np.sqrt(2)), np.float32)


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
    """Return the sum of octaves of noise, each of twice the frequency and ``gain`` the height.

    Args:
        x, y: Lattice coordinates of the first octave.
        rng: Gives the gradients of every octave.
        octaves: How many.
        gain: Height of each octave relative to the one before.
        kind: ``fbm`` (-1 to 1), ``billow`` (rounded lumps, 0 to 1) or ``ridged`` (crests, 0 to 1).
        period: Cells of the first octave after which the field repeats; None: it need not.
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


def warped(
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
    """Return (size, size) lattice coordinates of a square of ``extent``, cells ``cell`` wide."""
    axis = np.linspace(0.0, extent / cell, size)
    x, y = np.meshgrid(axis, axis)
    return x, y


def spectral(size: int, lowest: float, rng: np.random.Generator, rough: float) -> Field:
    """Return (size, size) fractal noise that tiles, of standard deviation 1.

    Args:
        size: Edge length.
        lowest: Frequency of its largest features, in waves per edge.
        rng: Gives the white noise that is filtered.
        rough: Exponent by which amplitudes fall with frequency: 1.4 is crumbly, 2.5 smooth.
    """
    white = rng.standard_normal((size, size), dtype=np.float32)
    frequency = np.hypot(
        scipy.fft.fftfreq(size, 1 / size)[:, None], scipy.fft.rfftfreq(size, 1 / size)[None, :]
    ).astype(np.float32)
    relative = frequency / np.float32(lowest)
    # Below the lowest frequency it fades out, because a sudden end would ring.
    gain = np.where(relative >= 1, np.maximum(relative, 1) ** np.float32(-rough), relative**4)
    gain[0, 0] = 0
    field = scipy.fft.irfft2(scipy.fft.rfft2(white) * gain, s=white.shape)
    return np.asarray(field / (field.std() + 1e-12), np.float32)
